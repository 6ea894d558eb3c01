"""Several environments in one process, stepped together: `gymnasium.make_vec('Raw2Drive-v3', N, ...)`."""

from __future__ import annotations

from typing import Any

from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.vector.utils import iterate

from raw2drive_ros.gym.env import Raw2DriveEnv
from raw2drive_ros.simulation.world_batch import WorldBatch


class Raw2DriveVectorEnv(SyncVectorEnv):
    """Returns what gymnasium's SyncVectorEnv would, in less time. Takes the arguments of `Raw2DriveEnv`, and
    autoreset_mode as SyncVectorEnv does."""

    def __init__(
        self, num_envs: int = 1, autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP, **kwargs: Any
    ) -> None:
        super().__init__([lambda: Raw2DriveEnv(**kwargs)] * num_envs, autoreset_mode=autoreset_mode)
        self.batch = WorldBatch([env.driving for env in self.envs])

    def step(self, actions: Any) -> Any:
        """Move the worlds of all environments that are not to be reset; then each observes its own."""
        controls = {
            i: env.control_of(action)
            for i, (env, action) in enumerate(zip(self.envs, iterate(self.action_space, actions), strict=True))
            if not (self.autoreset_mode == AutoresetMode.NEXT_STEP and self._autoreset_envs[i])
        }
        for i, stepped in self.batch.step(controls).items():
            self.envs[i].stepped = stepped
        return super().step(actions)
