"""The parser of the command line: errors are one line with a suggestion, and it knows which options were given."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Sequence
from typing import Any, NoReturn

from raw2drive_ros.contracts.errors import UsageError
from raw2drive_ros.contracts.near_names import did_you_mean


class Parser(argparse.ArgumentParser):
    """Wrong usage is one line on stderr and exit code 2, as errors of verbs are."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f'error: {message} (see {self.prog} --help)\n')

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is None or value in action.choices or value is argparse.SUPPRESS:
            return
        known = [str(choice) for choice in action.choices]
        near = did_you_mean(str(value), known)
        raise argparse.ArgumentError(action, f'{value!r} is none of {", ".join(known)}{near}')

    def refuse_unknown(self, words: Sequence[str], two_words: Sequence[str] = ()) -> None:
        """Exits for the first of the words that no option took; two_words: verbs whose first word is this one."""
        for word in words:
            if word.startswith('-'):
                name = word.partition('=')[0]
                self.error(f'{name}: no such option{did_you_mean(name, self._option_string_actions)}')
            verb = self.prog.partition(' ')[2]
            self.error(f'{word}: no such argument{did_you_mean(f"{verb} {word}", two_words)}')

    def named(self, arguments: Sequence[str]) -> dict[str, str]:
        """dest -> option or name of the argument, of everything that the command line gives itself."""
        defaults = [(action, action.default) for action in self._actions]
        try:
            for action, _ in defaults:
                action.default = argparse.SUPPRESS
            found = vars(self.parse_known_args(arguments, argparse.Namespace())[0])
        finally:
            for action, default in defaults:
                action.default = default
        return {action.dest: _name_of(action) for action, _ in defaults if action.dest in found}


def _name_of(action: argparse.Action) -> str:
    return action.option_strings[0] if action.option_strings else str(action.metavar or action.dest)


def refuse(options: argparse.Namespace, names: Iterable[str], why: str) -> None:
    """Raises UsageError when the command line gives one of these options (by dest): they would be without effect."""
    given = getattr(options, 'given', {})
    if found := [given[name] for name in names if name in given]:
        raise UsageError(f'{", ".join(found)}: {why}')


def refuse_all_but(options: argparse.Namespace, names: Iterable[str], what: str) -> None:
    """Raises UsageError when the command line gives another option than these, which are all that `what` reads."""
    given, wanted = getattr(options, 'given', {}), set(names)
    if found := [flag for name, flag in given.items() if name not in wanted]:
        raise UsageError(f'{", ".join(found)}: {what} takes no such option')


def at_least(options: argparse.Namespace, least: float, *names: str) -> None:
    """Raises UsageError for an option that is set to less than `least`."""
    for name in names:
        value = getattr(options, name)
        if value is not None and not value >= least:
            flag = getattr(options, 'given', {}).get(name, f'--{name.replace("_", "-")}')
            raise UsageError(f'{flag} {value:g}: give {least:g} or more')


def note(text: str) -> None:
    """One line for people, on stderr, where it disturbs no pipe."""
    print(text, file=sys.stderr)
