"""Where shipped files are: in the source tree, or in the installed share folder."""

from __future__ import annotations

from pathlib import Path

from raw2drive_ros.world_model.config import preset_folder


def default_bundle() -> Path:
    """The policy bundle that comes with the package."""
    return preset_folder() / 'bundles' / 'laptop'


def default_teacher() -> Path:
    """The privileged teacher that comes with the package."""
    return preset_folder() / 'bundles' / 'teacher'
