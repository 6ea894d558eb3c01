"""Keeps privileged code and topics out of the planner's process: importing or subscribing raises."""

from __future__ import annotations

import importlib.abc
import importlib.machinery
import sys
from collections.abc import Sequence
from types import ModuleType

from raw2drive_ros.contracts.errors import PrivilegedImportError

FORBIDDEN = (
    'msg_adapters.privileged',
    'msg_adapters.privileged_actors',
    'raw2drive_ros.contracts.privileged',
    'raw2drive_ros.simulation',
    'raw2drive_ros.training',
    'raw2drive_ros.evaluation',
    'raw2drive_ros.recording',
    # The privileged networks, what reads their runs, the codec of the masks that they see, and their inputs.
    'raw2drive_ros.world_model.teacher',
    'raw2drive_ros.world_model.run_files',
    'raw2drive_ros.world_model.mask_codec',
    'raw2drive_ros.world_model.privileged_inputs',
)


class _Blocker(importlib.abc.MetaPathFinder):
    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        if any(fullname == name or fullname.startswith(name + '.') for name in FORBIDDEN):
            raise PrivilegedImportError(f'{fullname} is privileged and cannot be imported by the planner')
        return None


def block_privileged_imports() -> None:
    """Make later imports of privileged code raise in this process. Raises PrivilegedImportError if it is too late."""
    loaded = sorted(m for m in sys.modules if any(m == name or m.startswith(name + '.') for name in FORBIDDEN))
    if loaded:
        raise PrivilegedImportError(f'already imported: {", ".join(loaded)}')
    sys.meta_path.insert(0, _Blocker())


def refuse_privileged_topic(topic: str) -> None:
    """Raises PrivilegedImportError for any topic under /privileged."""
    if '/privileged' in f'/{topic.lstrip("/")}':
        raise PrivilegedImportError(f'{topic} is privileged; the planner may not subscribe to it')
