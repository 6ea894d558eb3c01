"""What a mistyped name was probably meant to be: one place for every error about an unknown name."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

MOST = 3
# Of difflib's similarity, 0 to 1; below it suggestions are guesses.
SIMILAR = 0.6
# A suggestion that is followed by more names than these would be overlooked.
LISTED = 24


def near_names(name: str, known: Iterable[str]) -> list[str]:
    """The known names that are most like `name`, the nearest first, at most `MOST`; upper and lower case are alike."""
    by_plain: dict[str, str] = {}
    for other in known:
        by_plain.setdefault(other.lower(), other)
    if name.lower() in by_plain:
        return [by_plain[name.lower()]]
    return [by_plain[plain] for plain in difflib.get_close_matches(name.lower(), by_plain, MOST, SIMILAR)]


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """`; did you mean X or Y?` to append to an error, or nothing when no known name is near."""
    near = near_names(name, known)
    return f'; did you mean {" or ".join(near)}?' if near else ''


def unknown_name(kind: str, name: str, known: Iterable[str], more: str = '') -> str:
    """The text of an error: what is unknown, and what it may have been meant to be. more: appended.

    All known names follow, unless they are many and one of them is near.
    """
    names = list(known)
    near = did_you_mean(name, names)
    if near and len(names) > LISTED:
        return f'unknown {kind} {name!r}{near}{more}'
    return f'unknown {kind} {name!r}{near or ";"} known: {", ".join(names)}{more}'
