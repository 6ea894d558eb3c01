"""Where processes that this package starts look for modules: never in the working directory."""

from __future__ import annotations

import os
from pathlib import Path


def safe_path_variables() -> dict[str, str]:
    """Environment variables for a process started with `python -m` or `-c`: what it imports is what its parent has.

    A file `rclpy.py` in the working directory must not run in place of the library. PYTHONSAFEPATH keeps the working
    directory off the path (Python 3.11 or newer); so does dropping empty parts of PYTHONPATH, which mean the same.
    """
    root = str(Path(__file__).resolve().parents[1])
    others = (part for part in os.environ.get('PYTHONPATH', '').split(os.pathsep) if part and part != root)
    return {'PYTHONSAFEPATH': '1', 'PYTHONPATH': os.pathsep.join((root, *others))}
