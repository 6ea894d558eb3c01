"""The driving environment: one highway-env `AbstractEnv` for every scenario type.

10 Hz decisions, 20 Hz physics. `step` takes a `Control` and returns a `Tick`: the bridge publishes this object, the
collector writes it, and the evaluator passes it to the driver.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
from highway_env.envs.common.abstract import AbstractEnv
from highway_env.road.road import Road

from raw2drive_ros.contracts.actions import nearest_action
from raw2drive_ros.contracts.errors import UnknownScenarioError
from raw2drive_ros.contracts.privileged import PrivilegedFrame, Transition
from raw2drive_ros.contracts.public import CameraCalibration, Control, ImuSample, OdometrySample, Route, SensorFrame
from raw2drive_ros.simulation.bev import BevRenderer
from raw2drive_ros.simulation.camera_rig import camera_rig
from raw2drive_ros.simulation.criteria import Criteria
from raw2drive_ros.simulation.draws import Draw, Rng, rng_for
from raw2drive_ros.simulation.footprint import Way, ways_of
from raw2drive_ros.simulation.id_painter import IdPainter
from raw2drive_ros.simulation.privileged_view import PrivilegedView
from raw2drive_ros.simulation.protocol import PAIRS
from raw2drive_ros.simulation.renderer import CameraRenderer
from raw2drive_ros.simulation.reward import Outcome, RewardModel, vehicles_ahead_m
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.simulation.scenario import get_scenario
from raw2drive_ros.simulation.variation import NO_VARIATION, Variation, picture_rng
from raw2drive_ros.simulation.visibility import Visibility
from raw2drive_ros.simulation.weather import CLEAR, get_weather
from raw2drive_ros.simulation.world import World, step_worlds
from raw2drive_ros.tables.rates import DECISION_HZ, DECISION_NS, PHYSICS_HZ, PHYSICS_NS, SUBSTEPS

CLOCK_START_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class SimulationConfig:
    """image_size: (height, width). supersampling: 1 or 2. imu_noise: standard deviations of accelerometer (m/s2) and
    gyroscope (rad/s). end_on_infraction: end the episode at the first collision, red light or stop sign that was run,
    as the paper does for training; otherwise the drive goes on, after collisions too, as in Bench2Drive. vary: draw
    exposure, camera mounting, ground colours and sun anew for every episode (`variation.Variation`); repetitions of a
    route always do. protocol: see `simulation.protocol`. visibility: keep `DrivingEnv.visibility`; default: with
    cameras or BEV masks.
    """

    image_size: tuple[int, int] = (96, 160)
    cameras: bool = True
    bev: bool = True
    supersampling: int = 2
    imu_noise: tuple[float, float] = (0.0, 0.0)
    end_on_infraction: bool = True
    vary: bool = False
    protocol: str = PAIRS
    visibility: bool | None = None

    @property
    def sees(self) -> bool:
        """Whether the environment keeps account of what its cameras (would) see."""
        return self.cameras or self.bev if self.visibility is None else self.visibility


@dataclass(frozen=True, slots=True)
class Tick:
    """All data of one decision tick. The samples cover every physics step since the last tick, oldest first."""

    stamp_ns: int
    sensors: SensorFrame
    imu_samples: tuple[ImuSample, ...]
    odometry_samples: tuple[OdometrySample, ...]
    route: Route
    privileged: PrivilegedFrame | None
    transition: Transition
    info: dict[str, Any] = field(default_factory=dict)


# What a step returns: tick, reward, terminated, truncated, info.
Stepped = tuple[Tick, float, bool, bool, dict[str, Any]]


class DrivingEnv(AbstractEnv):
    """`reset(seed=..., options={'scenario': name})` or `reset_to(route)`, then `step(control)`; each returns a `Tick`.

    motion: longitudinal and lateral acceleration (m/s2) and yaw rate (rad/s) of every physics step of the episode.
    visibility: what the cameras see and have seen in this episode, None where `SimulationConfig.sees` is off.
    """

    def __init__(self, config: SimulationConfig | None = None) -> None:
        self.simulation = config or SimulationConfig()
        self.rig: tuple[CameraCalibration, ...] = camera_rig(*self.simulation.image_size)
        self.renderer = CameraRenderer(self.rig, self.simulation.supersampling)
        self.id_painter = IdPainter(self.rig, self.simulation.supersampling)
        self.visibility: Visibility | None = None
        self.world: World | None = None
        self.clock_ns = CLOCK_START_NS - DECISION_NS
        self.noise_rng: Rng = np.random.default_rng(0)
        gym.Env.__init__(self)
        self.config = {'policy_frequency': DECISION_HZ, 'simulation_frequency': PHYSICS_HZ}
        self.render_mode = None
        self.viewer = None
        self.controlled_vehicles: list[Any] = []
        self.define_spaces()

    def define_spaces(self) -> None:
        """Actions: throttle, brake, steer, reverse. Observations are `Tick` objects, not arrays."""
        self.action_space = gym.spaces.Box(np.array([0, 0, -1, 0], np.float32), np.array([1, 1, 1, 1], np.float32))
        self.observation_space = gym.spaces.Dict({})

    def reset(  # type: ignore[override]
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Tick, dict[str, Any]]:
        """Start scenario `options['scenario']` (default: LaneFollowing) with `seed` (default: 0).

        options may also hold `weather`, `repetition` and `twin`, see `RouteId`, and `time_limit_s`, after which the
        drive fails; None or nothing: the scene's own, see `criteria.time_limit_s`.

        Raises UnknownScenarioError, UnknownWeatherError.
        """
        chosen = options or {}
        name = chosen.get('scenario', 'LaneFollowing')
        seed = 0 if seed is None else int(seed)
        self.weather, repetition = get_weather(chosen.get('weather', CLEAR)), int(chosen.get('repetition', 0))
        twin, scenario = bool(chosen.get('twin', False)), get_scenario(name)
        if twin and not scenario.paired:
            raise UnknownScenarioError(f'scenario {name} has no twin')
        self.route_id = RouteId(name, seed, self.weather.name, repetition, twin)
        draw = Draw(name, seed, event=not twin)
        start_rng = rng_for(name, seed, repetition) if repetition else None
        self.world = World(scenario, draw, start_rng=start_rng)
        self.road = Road(self.world.road.network, [self.world.ego], [], np.random.RandomState(seed % 2**32))
        self.controlled_vehicles = [self.world.ego]
        self.noise_rng = draw.rng
        self.criteria = Criteria(chosen.get('time_limit_s'), self.simulation.protocol)
        self.criteria.step(self.world)
        self.rewards = RewardModel(self.world)
        self._new_pictures(self.world)
        self.bev = BevRenderer(self.world) if self.simulation.bev else None
        self.view = None if self.bev is None else PrivilegedView(self.world, self.bev)
        self.clock_ns += DECISION_NS
        self.route = Route(self.clock_ns, self.world.checkpoints_m())
        self.done = False
        self.reward_sum = 0.0
        self.motion: list[tuple[float, float, float]] = []
        imu, odometry = self._sample(self.clock_ns)
        first = Transition(self.clock_ns, -1, 0.0, {}, is_first=True, is_terminal=False, is_last=False)
        tick = self._tick((imu,), (odometry,), first, {})
        return tick, tick.info

    def reset_to(self, route: RouteId, time_limit_s: float | None = None) -> tuple[Tick, dict[str, Any]]:
        """Start a route; time_limit_s: see `reset`. Raises UnknownScenarioError, UnknownWeatherError."""
        options = {
            'scenario': route.type,
            'weather': route.weather,
            'repetition': route.repetition,
            'twin': route.twin,
            'time_limit_s': time_limit_s,
        }
        return self.reset(seed=route.seed, options=options)

    def step(  # type: ignore[override]
        self, action: Control
    ) -> Stepped:
        """One decision: two physics steps, then criteria and reward. Raises RuntimeError once the episode is over."""
        return step_together([self], [action])[0]

    def moved(self) -> tuple[ImuSample, OdometrySample]:
        """What the sensors measure after a physics step."""
        assert self.world is not None
        self.clock_ns += PHYSICS_NS
        self.motion.append((*self.world.ego.acceleration_body, self.world.ego.yaw_rate))
        return self._sample(self.clock_ns)

    def judged(
        self, control: Control, samples: Sequence[tuple[ImuSample, OdometrySample]], way: Way, vehicle_m: float
    ) -> Stepped:
        """Criteria, reward and observations of a decision whose physics steps are done."""
        assert self.world is not None
        happened = self.criteria.step(self.world, way)
        outcome = self.rewards.step(self.world, happened, self.criteria.step_outside_m, vehicle_m)
        self.reward_sum += outcome.reward
        terminated, truncated = self._ends(outcome)
        self.done = terminated or truncated
        transition = Transition(
            self.clock_ns,
            nearest_action(control),
            outcome.reward,
            outcome.terms,
            is_first=False,
            is_terminal=terminated,
            is_last=self.done,
        )
        info = {
            'infractions': happened,
            'cause': outcome.cause or self.criteria.failure,
            'target_speed_mps': outcome.target_speed_mps,
            'reward_terms': outcome.terms,
        }
        imus, odometries = zip(*samples)
        tick = self._tick(imus, odometries, transition, info)
        return tick, outcome.reward, terminated, truncated, info

    def _new_pictures(self, world: World) -> None:
        """Prepare all that looks at the world. Weather and variation have their own generator, so physics stay."""
        rng = picture_rng(self.route_id)
        varies = self.simulation.vary or self.route_id.repetition > 0
        variation = Variation.draw(rng, len(self.rig)) if varies else NO_VARIATION
        if self.simulation.cameras:
            self.renderer.counting = self.simulation.sees
            self.renderer.new_world(world, self.weather, variation, rng)
        self.visibility = None
        if self.simulation.sees:
            self.id_painter.new_world(world, self.weather, variation)
            height, width = self.simulation.image_size
            self.visibility = Visibility(self.weather, len(self.rig), height * width)

    def _ends(self, outcome: Outcome) -> tuple[bool, bool]:
        """(terminated, truncated)."""
        assert self.world is not None
        if outcome.truncated or self.criteria.finished(self.world):
            return False, True
        if self.simulation.end_on_infraction:
            if outcome.terminal:
                return True, False
            return False, bool(self.criteria.failure)
        return bool(self.criteria.failure), False

    def _sample(self, stamp_ns: int) -> tuple[ImuSample, OdometrySample]:
        assert self.world is not None
        noise = (0.0,) * 6
        accelerometer, gyroscope = self.simulation.imu_noise
        if accelerometer or gyroscope:
            drawn = self.noise_rng.standard_normal(6)
            noise = tuple(drawn * ([accelerometer] * 3 + [gyroscope] * 3))
        return self.world.ego.imu(stamp_ns, noise), self.world.ego.odometry(stamp_ns)

    def _look(self, world: World) -> None:
        """Bring `visibility` up to date; without cameras by an id buffer of its own."""
        if self.visibility is None:
            return
        counts, signals = self.renderer.counts, self.renderer.signal_counts
        if not self.simulation.cameras or counts is None or signals is None:
            counts, signals = self.id_painter.count()
        self.visibility.update(world, counts, signals)

    def _tick(
        self,
        imus: tuple[ImuSample, ...],
        odometries: tuple[OdometrySample, ...],
        transition: Transition,
        info: dict[str, Any],
    ) -> Tick:
        assert self.world is not None
        images = self.renderer.render() if self.simulation.cameras else {}
        self._look(self.world)
        privileged = None if self.view is None else self.view.frame(self.clock_ns, self.visibility)
        sensors = SensorFrame(self.clock_ns, images, imus[-1], odometries[-1])
        return Tick(self.clock_ns, sensors, imus, odometries, self.route, privileged, transition, info)


def step_together(envs: Sequence[DrivingEnv], actions: Sequence[Control]) -> list[Stepped]:
    """One decision in each of several environments: the same as one after the other, in less time.

    Raises RuntimeError where an episode is over.
    """
    if any(env.world is None or env.done for env in envs):
        raise RuntimeError('DrivingEnv.step: the episode is over; call reset')
    controls = [action.validate() for action in actions]
    worlds = [env.world for env in envs if env.world is not None]
    samples: list[list[tuple[ImuSample, OdometrySample]]] = [[] for _ in envs]
    for _ in range(SUBSTEPS):
        step_worlds(worlds, controls)
        for env, measured in zip(envs, samples):
            measured.append(env.moved())
    found = zip(envs, controls, samples, ways_of(worlds), vehicles_ahead_m(worlds), strict=True)
    return [env.judged(control, measured, way, vehicle_m) for env, control, measured, way, vehicle_m in found]
