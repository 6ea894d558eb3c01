"""Verification by replay: does a bundle, given the sensor data of a bag, decide what was recorded there?"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from msg_adapters.commands import decision_from_message
from msg_adapters.factory import RosbagsFactory
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.errors import BagError
from raw2drive_ros.contracts.public import Control, SensorFrame
from raw2drive_ros.driving.bundle import load_bundle
from raw2drive_ros.driving.raw_driver import RawDriver
from raw2drive_ros.recording.bag_reader import decoded, messages_in, open_bag
from raw2drive_ros.recording.ticks import read_ticks

FIELDS = ('throttle', 'brake', 'steer', 'reverse')


@dataclass(frozen=True, slots=True)
class Verification:
    """compared: decisions that were recorded and made again. left_out: ticks without a recorded decision. differing:
    number of differences by field; mean_difference: their mean size. first: the first decision that differs: its stamp,
    field, both values. text: the verdict in a sentence.
    """

    equal: bool
    compared: int
    left_out: int
    differing: dict[str, int]
    mean_difference: dict[str, float]
    first: dict[str, Any] | None
    text: str


def recorded_proposals(bag: Path) -> dict[int, Control]:
    """stamp -> control of every proposal in a bag. Raises BagError when it has none."""
    factory = RosbagsFactory()
    found: dict[int, Control] = {}
    with open_bag(bag) as reader:
        connections = [c for c in reader.connections if c.topic == topics.PROPOSED]
        # An empty list of connections would select all of them.
        for connection, _, data in messages_in(reader, connections=connections) if connections else ():
            decision = decision_from_message(decoded(factory, reader, connection, data))
            found[decision.stamp_ns] = decision.control
    if not found:
        raise BagError(f'{bag}: has no {topics.PROPOSED}; record a drive of the raw policy')
    return found


def verify_bag(bag: Path, bundle: Path) -> Verification:
    """Compare bit for bit, and name the first difference. Raises BagError or BundleError."""
    wanted = recorded_proposals(bag)
    driver = RawDriver(load_bundle(bundle))
    compared = left_out = changed = 0
    differences: dict[str, list[float]] = {name: [] for name in FIELDS}
    first: dict[str, Any] | None = None
    with open_bag(bag) as reader:
        for tick in read_ticks(reader, bag, cameras=True, privileged=False):
            if tick.stamp_ns not in wanted:
                # The planner was inactive or rejected its sensors: its recurrent state did not advance at this tick.
                left_out += 1
                continue
            decision = driver.drive(SensorFrame(tick.stamp_ns, tick.images, tick.imu, tick.odometry), tick.route)
            compared += 1
            recorded = wanted[tick.stamp_ns]
            changed += decision.control != recorded
            for name in FIELDS:
                old, new = getattr(recorded, name), getattr(decision.control, name)
                if old != new:
                    differences[name].append(abs(float(new) - float(old)))
                    first = first or {'stamp_ns': tick.stamp_ns, 'field': name, 'recorded': old, 'now': new}
    differing = {name: len(found) for name, found in differences.items() if found}
    mean = {name: sum(found) / len(found) for name, found in differences.items() if found}
    text = _text(compared, left_out, changed, differing, mean, first)
    return Verification(first is None, compared, left_out, differing, mean, first, text)


def _text(
    compared: int,
    left_out: int,
    changed: int,
    differing: dict[str, int],
    mean: dict[str, float],
    first: dict[str, Any] | None,
) -> str:
    rest = f'; {left_out} ticks have no recorded decision' if left_out else ''
    if first is None:
        return f'{compared} decisions are equal, bit for bit{rest}'
    fields = ', '.join(f'{name} {count} times by {mean[name]:.2f} on average' for name, count in differing.items())
    where = (
        f'first {topics.PROPOSED} at {first["stamp_ns"]} ns: {first["field"]} {first["recorded"]} recorded, '
        f'{first["now"]} now'
    )
    return f'{changed} of {compared} decisions differ: {fields}; {where}{rest}'
