"""Several driving environments in one process that are stepped together.

What numpy does for one world takes little longer for eight, so the searches of all worlds (leaders, lanes under the
cars, vehicles ahead) are one. Every world goes through the same states, bit for bit, as it would alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from raw2drive_ros.contracts.public import Control
from raw2drive_ros.simulation.environment import DrivingEnv, Stepped, Tick, step_together
from raw2drive_ros.simulation.route_id import RouteId


class WorldBatch:
    """envs: each with its own configuration, world and episode."""

    def __init__(self, envs: Sequence[DrivingEnv]) -> None:
        self.envs = list(envs)

    def reset(self, index: int, route: RouteId, time_limit_s: float | None = None) -> Tick:
        """Start a route in one environment. Raises UnknownScenarioError, UnknownWeatherError."""
        return self.envs[index].reset_to(route, time_limit_s)[0]

    @property
    def driving(self) -> list[int]:
        """Indices of the environments whose episode is not over."""
        return [i for i, env in enumerate(self.envs) if env.world is not None and not env.done]

    def step(self, controls: Mapping[int, Control]) -> dict[int, Stepped]:
        """One decision of 0.1 s in some environments, by index; what `DrivingEnv.step` returns for each.

        Raises RuntimeError where an episode is over or has not begun.
        """
        order = list(controls)
        stepped = step_together([self.envs[i] for i in order], [controls[i] for i in order])
        return dict(zip(order, stepped, strict=True))
