"""The driving simulation as a gymnasium environment, see docs/gym.md."""

from __future__ import annotations

import math
import operator
from typing import Any, ClassVar

import cv2
import gymnasium
import numpy as np
from gymnasium.spaces import Box, Discrete
from numpy.typing import NDArray

from raw2drive_ros.contracts.actions import ACTION_COUNT, ACTIONS
from raw2drive_ros.contracts.errors import RouteIdError
from raw2drive_ros.contracts.public import Control
from raw2drive_ros.evaluation.episode import result_of
from raw2drive_ros.gym.observations import Observation, observer_of
from raw2drive_ros.gym.picture import picture_of
from raw2drive_ros.gym.route_source import Start, route_source
from raw2drive_ros.simulation.environment import DrivingEnv, SimulationConfig, Stepped, Tick
from raw2drive_ros.simulation.route_id import RouteId
from raw2drive_ros.tables.rates import DECISION_HZ

DISCRETE, CONTINUOUS = 'discrete', 'continuous'
RENDER_MODES = ('rgb_array',)


class Raw2DriveEnv(gymnasium.Env[Observation, Any]):
    """One car on one route at a time, 10 decisions per second.

    suite: draw the routes from this one (name, or path of a .json file), with its time limits; None: endless training
    routes of the types `routes` (scenario types, abilities or all, as on the command line), of which the share `twins`
    are twins, drives in which nothing happens. weather: always this one; None: any, or the suite's own.
    observation: 'cameras', 'bev', 'bev_visible' or 'vector', see `gym.observations`. action: 'discrete', an index into
    the table of 39 actions, or 'continuous', (2,) in [-1, 1]: pedal, positive is throttle and negative brake, and
    steering, positive to the LEFT. image_size: (height, width) of the cameras. end_on_infraction: the episode ends with
    the first collision, red light or stop sign that was run; otherwise as in an evaluation. render_mode: 'rgb_array' or
    None; a step then makes cameras and masks, whatever is observed.

    `reset(options={'route': 'Accident/100000'})` drives a certain route, `TYPE[-twin]/SEED[/WEATHER[/REPETITION]]`.
    Every info holds route, infractions of this step, cause of the end and reward_terms; the last one of an episode also
    result, a `RouteResult`, and success. Terminated means failed; the goal is a truncation, as is a time limit.

    Raises UnknownSuiteError, UnknownScenarioError, UnknownWeatherError, ValueError and gymnasium.error.Error.
    """

    metadata: ClassVar[dict[str, Any]] = {'render_modes': list(RENDER_MODES), 'render_fps': DECISION_HZ}

    def __init__(
        self,
        suite: str | None = None,
        routes: str = 'all',
        observation: str = 'cameras',
        action: str = DISCRETE,
        *,
        weather: str | None = None,
        twins: float = 1.0 / 3.0,
        image_size: tuple[int, int] = (96, 160),
        end_on_infraction: bool = True,
        render_mode: str | None = None,
    ) -> None:
        if action not in (DISCRETE, CONTINUOUS):
            raise gymnasium.error.Error(f'action {action!r} is none of {DISCRETE}, {CONTINUOUS}')
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise gymnasium.error.Error(f'render_mode {render_mode!r} is none of {", ".join(RENDER_MODES)}')
        # More threads for pictures as small as these only wait for each other.
        cv2.setNumThreads(1)
        self.source = route_source(suite, routes, weather, twins)
        image_size = (int(image_size[0]), int(image_size[1]))
        shown = render_mode is not None
        probe = observer_of(observation, image_size, ())
        self.driving = DrivingEnv(
            SimulationConfig(
                image_size,
                cameras=probe.cameras or shown,
                bev=probe.bev or shown,
                visibility=probe.visibility,
                end_on_infraction=end_on_infraction,
            )
        )
        self.observer = observer_of(observation, image_size, self.driving.rig)
        self.observation_space = self.observer.space
        self.discrete = action == DISCRETE
        self.action_space = Discrete(ACTION_COUNT) if self.discrete else Box(-1.0, 1.0, (2,), np.float32)
        self.render_mode = render_mode
        self.tick: Tick | None = None
        # Of a world that was stepped together with others; the next `step` returns it.
        self.stepped: Stepped | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start the next route, or `options['route']`. Raises RouteIdError, UnknownScenarioError."""
        super().reset(seed=seed)
        self.stepped = None
        start = self._start(options or {})
        self.tick, _ = self.driving.reset_to(start.route, start.limit_s)
        self.observer.reset()
        return self.observer.see(self.driving, self.tick), self._info(self.tick)

    def _start(self, options: dict[str, Any]) -> Start:
        if unknown := sorted(set(options) - {'route'}):
            raise RouteIdError(f'reset: options {", ".join(unknown)}: there is only route')
        if 'route' not in options:
            return self.source.draw(self.np_random)
        return self.source.start(RouteId.parse(str(options['route'])))

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """One decision of 0.1 s. Raises gymnasium.error.ResetNeeded after the end of an episode."""
        if self.tick is None or (self.driving.done and self.stepped is None):
            raise gymnasium.error.ResetNeeded('the episode is over, or none has begun: call reset')
        stepped, self.stepped = self.stepped, None
        self.tick, reward, terminated, truncated, _ = stepped or self.driving.step(self.control_of(action))
        observation = self.observer.see(self.driving, self.tick)
        return observation, reward, terminated, truncated, self._info(self.tick)

    def control_of(self, action: Any) -> Control:
        """The command that an action means; continuous ones beyond [-1, 1] are cut off. Raises
        gymnasium.error.InvalidAction."""
        try:
            if self.discrete:
                index = operator.index(action.item() if isinstance(action, np.ndarray) else action)
                if 0 <= index < ACTION_COUNT:
                    return ACTIONS[index]
            else:
                pedal, steer = np.clip(np.asarray(action, np.float64), -1.0, 1.0).tolist()
                if math.isfinite(pedal + steer):
                    return Control(max(pedal, 0.0), max(-pedal, 0.0), steer)
        except (TypeError, ValueError):
            pass
        raise gymnasium.error.InvalidAction(f'action {action!r} is not in {self.action_space}')

    def _info(self, tick: Tick) -> dict[str, Any]:
        info = {
            'route': str(self.driving.route_id),
            'infractions': tuple(tick.info.get('infractions', ())),
            'cause': tick.info.get('cause', ''),
            'reward_terms': dict(tick.transition.reward_terms),
        }
        if tick.transition.is_last:
            result = result_of(self.driving)
            info |= {'result': result, 'success': result.success}
        return info

    def render(self) -> NDArray[np.uint8] | None:  # type: ignore[override]
        """(H, W, 3) uint8 RGB: the cameras, and the masks from above. None without a render mode."""
        if self.render_mode is None:
            gymnasium.logger.warn('render: the environment was made without render_mode="rgb_array"')
            return None
        if self.tick is None:
            raise gymnasium.error.ResetNeeded('there is nothing to render yet: call reset')
        return picture_of(self.tick)
