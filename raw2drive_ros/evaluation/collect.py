"""The in-process collector: drives episodes and writes the same bags that the graph's recorder writes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path

import numpy as np

from msg_adapters.commands import decision_to_message
from msg_adapters.factory import RosbagsFactory
from msg_adapters.privileged import advice_to_message
from raw2drive_ros.contracts import topics
from raw2drive_ros.contracts.privileged import Advice
from raw2drive_ros.evaluation.collection_journal import FinishedBag, open_journal
from raw2drive_ros.evaluation.episode import as_received
from raw2drive_ros.evaluation.episode_driver import EpisodeDriver
from raw2drive_ros.evaluation.table_actions import ADVICE, ADVICE_REASON
from raw2drive_ros.evaluation.tick_messages import TickMessages
from raw2drive_ros.recording.bag_writer import BagWriter
from raw2drive_ros.simulation.draws import TRAIN_SEED_START
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig, Tick
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.simulation.scenario import REGISTRY, load_scenarios
from raw2drive_ros.simulation.weather import CLEAR

# Number of route seeds reserved for each collection.
SEEDS_PER_COLLECTION = 10_000
STANDING_MPS = 0.1
# Scenario types, weathers and twins are drawn from separate generators, seeded with these.
TYPE_STREAM, WEATHER_STREAM, TWIN_STREAM = 1, 2, 3


@dataclass(frozen=True, slots=True)
class CollectConfig:
    """ticks: decision ticks to write in all. episode_ticks: an episode is cut after this many. stand_ticks: and after
    this many without motion (0: never), because a driver that is stuck fills bags with one frame. image_size: (H, W).
    scenarios, weathers: one of each per episode, see `episode_route`; an entry listed twice is drawn twice as often.
    seed: of the collection, 0 or more (ValueError). vary: see `SimulationConfig`. twins: share of the episodes of types
    that have a twin in which the twin is driven, where nothing happens."""

    scenarios: tuple[str, ...]
    ticks: int
    seed: int = 0
    cameras: bool = True
    episode_ticks: int = 400
    stand_ticks: int = 0
    bag_ticks: int = 2000
    image_size: tuple[int, int] = (96, 160)
    weathers: tuple[str, ...] = (CLEAR,)
    vary: bool = False
    twins: float = 1.0 / 3.0

    def __post_init__(self) -> None:
        if self.seed < 0:
            # Route seeds below `TRAIN_SEED_START` are those of evaluation and validation.
            raise ValueError(f'CollectConfig: seed {self.seed}: give 0 or more')
        if not 0.0 <= self.twins <= 1.0:
            raise ValueError(f'CollectConfig: twins {self.twins}: a share, from 0 to 1')


def episode_route(config: CollectConfig, number: int) -> RouteId:
    """The route of episode `number` (from 0 on) of a collection; depends on nothing else that was driven.

    Scenario types and weathers are two independent sequences. Each concatenates random permutations of its list, so
    that every entry occurs equally often and the weather does not depend on the type. Whether it is a twin is a
    third, independent draw.
    """
    kind = _permuted(config.scenarios, config.seed, TYPE_STREAM, number)
    drawn = np.random.default_rng([config.seed, TWIN_STREAM, number]).random()
    return RouteId(
        kind,
        TRAIN_SEED_START + SEEDS_PER_COLLECTION * config.seed + number,
        _permuted(config.weathers, config.seed, WEATHER_STREAM, number),
        twin=bool(drawn < config.twins) and _paired(kind),
    )


def _paired(kind: str) -> bool:
    """Whether a type has a twin; an unknown type has none, and is refused where it is driven."""
    _load_once()
    return kind in REGISTRY and REGISTRY[kind].paired


@cache
def _load_once() -> None:
    load_scenarios()


def _permuted(names: Sequence[str], seed: int, stream: int, number: int) -> str:
    """Entry `number` of an endless concatenation of random permutations of `names`."""
    turn, place = divmod(number, len(names))
    order = np.random.default_rng([seed, stream, turn]).permutation(len(names))
    return names[int(order[place])]


def collect(
    folder: Path, config: CollectConfig, driver: EpisodeDriver, provenance: dict[str, str], identity: str = ''
) -> Iterator[tuple[int, Path]]:
    """Write bags into `folder`; yields (ticks written so far, path of the bag) after each episode.

    Called again after an interruption it goes on with the bag that was not finished and ends with the same messages.
    identity: of the driver and its weights, see `DriverSpec.identity`; another one is another collection. Raises
    BagExistsError where bags of another collection have the same names, or another process is writing these.
    """
    what = asdict(config) | {'provenance': provenance, 'identity': identity}
    simulation = SimulationConfig(config.image_size, cameras=config.cameras, vary=config.vary)
    env = DrivingEnv(simulation)
    messages = TickMessages(RosbagsFactory(), env.rig)
    number = done_ticks = 0
    with open_journal(folder, _bag_name(config, provenance, 0), what) as journal:
        while done_ticks < config.ticks:
            path = folder / _bag_name(config, provenance, number)
            if (done := journal.whole(path.name)) is not None:
                number, done_ticks, env.clock_ns = number + done.episodes, done_ticks + done.ticks, done.clock_ns
                yield done_ticks, path
                continue
            journal.begin(path.name)
            first = episode_route(config, number)
            metadata = provenance | {'first_seed': str(first.seed), 'scenarios': ','.join(config.scenarios)}
            with BagWriter(path, metadata) as bag:
                for topic, stamp, message in messages.latched(env.clock_ns):
                    bag.write(topic, stamp, message)
                in_bag, begins = 0, number
                while in_bag < config.bag_ticks and done_ticks + in_bag < config.ticks:
                    in_bag += _episode(env, messages, bag, episode_route(config, number), driver, config)
                    number += 1
                    yield done_ticks + in_bag, path
                # Before the bag gets its name: a bag that is there and has this note is whole.
                journal.finish(FinishedBag(path.name, number - begins, in_bag, env.clock_ns))
            done_ticks += in_bag


def _bag_name(config: CollectConfig, provenance: dict[str, str], number: int) -> str:
    """Of the bag that begins with episode `number`."""
    return f'{provenance.get("driver", "driver")}_{episode_route(config, number).seed:06d}'


def _episode(
    env: DrivingEnv,
    messages: TickMessages,
    bag: BagWriter,
    route: RouteId,
    driver: EpisodeDriver,
    config: CollectConfig,
) -> int:
    """Drive one episode into the bag; returns its number of ticks."""
    factory = bag.factory
    driver.reset(route.seed)
    tick, _ = env.reset_to(route)
    bag.write(*messages.route(tick))
    ticks = stood = 0
    while True:
        _write_tick(bag, messages, tick, str(route))
        ticks += 1
        stood = stood + 1 if abs(tick.sensors.odometry.speed_mps) < STANDING_MPS else 0
        if env.done or ticks >= config.episode_ticks or (config.stand_ticks and stood >= config.stand_ticks):
            return ticks
        decision = driver.control(env, as_received(factory, tick), tick)
        bag.write(topics.COMMAND, tick.stamp_ns, decision_to_message(messages.factory, decision))
        if ADVICE in decision.info:
            advice = Advice(tick.stamp_ns, decision.info[ADVICE], decision.info[ADVICE_REASON])
            bag.write(topics.ADVICE, tick.stamp_ns, advice_to_message(messages.factory, advice))
        tick, *_ = env.step(decision.control)


def _write_tick(bag: BagWriter, messages: TickMessages, tick: Tick, episode: str) -> None:
    for source in (messages.motion(tick), messages.cameras(tick), messages.privileged(tick, episode)):
        for topic, stamp, message in source:
            bag.write(topic, stamp, message)
