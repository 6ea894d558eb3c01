"""Old spellings of the command line: they work for one more release and warn with the new spelling."""

from __future__ import annotations

import sys


def warn_old(old: str, new: str) -> None:
    """Print one line on stderr."""
    print(f'warning: {old} is an old spelling and goes with version 0.4; write: {new}', file=sys.stderr)
