"""The in-process collector: drives episodes and writes the same bags that the graph's recorder writes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from msg_adapters.commands import decision_to_message
from msg_adapters.factory import RosbagsFactory
from msg_adapters.privileged import advice_to_message
from raw2drive_ros import topics
from raw2drive_ros.evaluation.episode import as_received
from raw2drive_ros.evaluation.episode_driver import EpisodeDriver
from raw2drive_ros.evaluation.tick_messages import TickMessages
from raw2drive_ros.recording.bag_writer import BagWriter
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig, Tick
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.simulation.weather import CLEAR

# Collection seeds start here, so that no collected route is an evaluation route (seeds 0 ... 9,999).
TRAIN_SEED_START = 100_000
STANDING_MPS = 0.1


@dataclass(frozen=True, slots=True)
class CollectConfig:
    """ticks: decision ticks to write. episode_ticks: an episode is cut after so many, and after `stand_ticks` (0:
    never) without motion, because a driver that is stuck fills bags with one frame. image_size: (H, W).
    weathers: taken in turn, one an episode. vary: see `SimulationConfig`."""

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


def collect(
    folder: Path,
    config: CollectConfig,
    driver: EpisodeDriver,
    provenance: dict[str, str],
) -> Iterator[tuple[int, Path]]:
    """Write bags into `folder`; yields (ticks so far, bag) after each tick batch of an episode."""
    simulation = SimulationConfig(config.image_size, cameras=config.cameras, vary=config.vary)
    env = DrivingEnv(simulation)
    messages = TickMessages(RosbagsFactory(), env.rig)
    seed = TRAIN_SEED_START + 10_000 * config.seed
    first = seed
    done_ticks = 0
    while done_ticks < config.ticks:
        path = folder / f'{provenance.get("driver", "driver")}_{seed:06d}'
        metadata = provenance | {'first_seed': str(seed), 'scenarios': ','.join(config.scenarios)}
        with BagWriter(path, metadata) as bag:
            for topic, stamp, message in messages.latched(env.clock_ns):
                bag.write(topic, stamp, message)
            in_bag = 0
            while in_bag < config.bag_ticks and done_ticks + in_bag < config.ticks:
                number = seed - first
                name = config.scenarios[number % len(config.scenarios)]
                # One weather further on with every round through the scenarios, or some pairs would never meet.
                weather = config.weathers[(number + number // len(config.scenarios)) % len(config.weathers)]
                in_bag += _episode(env, messages, bag, RouteId(name, seed, weather), driver, config)
                seed += 1
                yield done_ticks + in_bag, path
        done_ticks += in_bag


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
        if 'advice' in decision.info:
            advice = advice_to_message(messages.factory, decision.info['advice'], tick.stamp_ns)
            bag.write(topics.ADVICE, tick.stamp_ns, advice)
        tick, *_ = env.step(decision.control)


def _write_tick(bag: BagWriter, messages: TickMessages, tick: Tick, episode: str) -> None:
    for source in (messages.motion(tick), messages.cameras(tick), messages.privileged(tick, episode)):
        for topic, stamp, message in source:
            bag.write(topic, stamp, message)
