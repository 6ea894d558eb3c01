"""Plans of faults, read from YAML: which topic, what happens to it, from when to when."""

from __future__ import annotations

import math
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Literal

from pydantic import Field, model_validator

from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import ConfigError
from raw2drive_ros.contracts.near_names import did_you_mean, unknown_name
from raw2drive_ros.settings import Strict, load_strict, params_folder

Kind = Literal[
    'drop',
    'delay',
    'freeze',
    'duplicate',
    'stamp',
    'nan',
    'noise',
    'scale',
    'black',
    'white',
    'shrink',
    'swing',
    'lock',
]
# Meaning and default of `amount` by kind. None: the kind takes no amount.
AMOUNTS: dict[str, tuple[str, float] | None] = {
    'drop': ('share of messages', 1.0),
    'delay': ('seconds', 0.5),
    'freeze': None,
    'duplicate': None,
    'stamp': ('seconds added to the stamp', -1.0),
    'nan': None,
    'noise': ('standard deviation in the unit of the values (grey levels of images)', 10.0),
    'scale': ('factor', 100.0),
    'black': None,
    'white': None,
    'shrink': None,
    'swing': ('steer, with alternating sign', 1.0),
    'lock': ('steer', 1.0),
}
IMAGES, VALUES, COMMANDS = ('black', 'white', 'shrink'), ('nan', 'scale'), ('swing', 'lock')


class Fault(Strict):
    """topic: a name or a pattern with `*`. start_s, duration_s: of ROS time since the start of the drive.

    kind: drop (lose a share), delay (arrive later), freeze (the last content before the fault, under new stamps),
    duplicate (arrive twice), stamp (wrong stamps), nan, noise, scale (values times a factor), black and white (images),
    shrink (images whose size contradicts their data), swing and lock (steering of commands).
    """

    topic: str
    kind: Kind
    start_s: float = Field(5.0, ge=0)
    duration_s: float = Field(math.inf, gt=0)
    amount: float | None = None

    @model_validator(mode='after')
    def _fits(self) -> Fault:
        hit = [spec for spec in topics.TOPICS if fnmatchcase(spec.name, self.topic)]
        if not hit:
            near = did_you_mean(self.topic, [spec.name for spec in topics.TOPICS if not spec.privileged])
            raise ValueError(f'no topic is called {self.topic!r}{near}')
        if any(spec.privileged for spec in hit):
            raise ValueError(f'{self.topic!r} covers a privileged topic, which no planner hears')
        if self.amount is not None and AMOUNTS[self.kind] is None:
            raise ValueError(f'{self.kind} takes no amount')
        for kinds, types in (
            (IMAGES, ('sensor_msgs/msg/Image',)),
            (VALUES, ('sensor_msgs/msg/Imu', 'nav_msgs/msg/Odometry', 'sensor_msgs/msg/JointState')),
            (COMMANDS, ('sensor_msgs/msg/JointState',)),
            (('noise',), ('sensor_msgs/msg/Image', 'sensor_msgs/msg/Imu', 'nav_msgs/msg/Odometry')),
        ):
            wrong = [spec.name for spec in hit if self.kind in kinds and spec.msgtype not in types]
            if wrong:
                raise ValueError(f'{self.kind} does not go with {wrong[0]}')
        return self

    @property
    def strength(self) -> float:
        found = AMOUNTS[self.kind]
        return self.amount if self.amount is not None else (found[1] if found else 0.0)

    def holds(self, topic: str, since_start_s: float) -> bool:
        """Whether the fault affects `topic` at this time."""
        return self.holds_at(since_start_s) and fnmatchcase(topic, self.topic)

    def holds_at(self, since_start_s: float) -> bool:
        """Whether the fault is active at this time."""
        return self.start_s <= since_start_s < self.start_s + self.duration_s


class FaultPlans(Strict):
    """The whole file. plans: name -> faults that are applied together."""

    seed: int = 0
    plans: dict[str, list[Fault]] = Field(min_length=1)


def load_plans(name: str) -> FaultPlans:
    """A YAML file, or the name of one in `params/faults`. Raises ConfigError that names the field."""
    path = Path(name)
    if path.suffix != '.yaml':
        folder = params_folder() / 'faults'
        path = folder / f'{name}.yaml'
        if not path.is_file():
            known = sorted(p.stem for p in folder.glob('*.yaml'))
            raise ConfigError(unknown_name('fault plans', name, known, '; or give a .yaml file'))
    return load_strict(FaultPlans, path)


def load_plan(plans: str, plan: str) -> list[Fault]:
    """The faults of one plan of a file of plans, see `load_plans`. Raises ConfigError."""
    known = load_plans(plans).plans
    if plan not in known:
        raise ConfigError(unknown_name('plan', plan, known, f' (plans of {plans})'))
    return known[plan]


def touched_topics(faults: list[Fault]) -> list[str]:
    """Every topic that a plan may change."""
    return [spec.name for spec in topics.TOPICS if any(fnmatchcase(spec.name, fault.topic) for fault in faults)]


def behind_injector(topic: str) -> str:
    """Topic on which the injector node publishes its version of `topic`."""
    return '/faulty' + topic


def remapping(faults: list[Fault], heard: tuple[str, ...]) -> dict[str, str]:
    """topic -> topic behind the injector, for a node that subscribes to `heard`."""
    return {name: behind_injector(name) for name in touched_topics(faults) if name in heard}
