"""`import raw2drive_ros.gym` registers the environment `Raw2Drive-v3` with gymnasium; see docs/gym.md.

`gymnasium.make('raw2drive_ros.gym:Raw2Drive-v3')` does the import itself.
"""

from __future__ import annotations

from gymnasium.envs.registration import register, registry

ENV_ID = 'Raw2Drive-v3'

if ENV_ID not in registry:
    # As texts, so that this import, which others may do for them, loads nothing of the simulator.
    register(
        ENV_ID,
        entry_point='raw2drive_ros.gym.env:Raw2DriveEnv',
        vector_entry_point='raw2drive_ros.gym.vector_env:Raw2DriveVectorEnv',
    )
