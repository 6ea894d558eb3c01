"""Texts of unknown origin on the terminal."""

from __future__ import annotations


def shown(text: object) -> str:
    """A text in which control characters, also those that turn or hide text, are written as escapes.

    Names and texts from bags, messages and files may hold anything; printed raw, they could move the cursor, colour or
    clear the screen, or add lines that look like ours.
    """
    return ''.join(c if c.isprintable() else c.encode('unicode_escape').decode() for c in str(text))
