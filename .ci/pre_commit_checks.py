"""Checks that the hooks of `.pre-commit-config.yaml` run on the files of a commit. Standard library only.

python .ci/pre_commit_checks.py large-files|private-keys|package-xml FILE [FILE ...]

Prints one line per fault. Exit codes: 0 nothing found, 1 faults, 2 wrong usage.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from xml.parsers import expat

MIB = 1 << 20
LARGEST_BYTES = 2 * MIB

# PEM (OpenSSL, OpenSSH, SROS2), PGP, PuTTY and age.
PRIVATE_KEY = re.compile(
    rb'-----BEGIN (?:[A-Z0-9]+ )*PRIVATE KEY(?: BLOCK)?-----|PuTTY-User-Key-File-\d+:|AGE-SECRET-KEY-1[A-Z0-9]{20}'
)

# The elements of a package.xml of format 3 (REP 149), in the order in which they have to stand.
PACKAGE_ORDER = (
    'name',
    'version',
    'description',
    'maintainer',
    'license',
    'url',
    'author',
    'buildtool_depend',
    'buildtool_export_depend',
    'build_depend',
    'build_export_depend',
    'depend',
    'exec_depend',
    'doc_depend',
    'test_depend',
    'conflict',
    'replace',
    'group_depend',
    'member_of_group',
    'export',
)
PACKAGE_REQUIRED = PACKAGE_ORDER[:5]


def large_files(path: Path) -> Iterator[str]:
    """A file over LARGEST_BYTES: history never gets smaller again."""
    size = path.stat().st_size
    if size > LARGEST_BYTES:
        yield f'{size / MIB:.1f} MiB; the largest file that may be committed has {LARGEST_BYTES // MIB} MiB'


def private_keys(path: Path) -> Iterator[str]:
    """The beginning of a private key, anywhere in a file, text or not."""
    data = path.read_bytes()
    for found in PRIVATE_KEY.finditer(data):
        line = data.count(b'\n', 0, found.start()) + 1
        yield f'line {line}: a private key; take it out, and make a new one if it has left your machine'


def package_xml(path: Path) -> Iterator[str]:
    """Elements of a package.xml out of order, unknown or missing."""
    try:
        elements = _children(path.read_bytes())
    except expat.ExpatError as error:
        yield f'not XML: {error}'
        return
    missing = [name for name in PACKAGE_REQUIRED if name not in {name for name, _ in elements}]
    if missing:
        yield f'missing: {", ".join(missing)}'
    last = PACKAGE_ORDER[0]
    for name, line in elements:
        if name not in PACKAGE_ORDER:
            yield f'line {line}: REP 149 knows no <{name}>'
        elif PACKAGE_ORDER.index(name) < PACKAGE_ORDER.index(last):
            yield f'line {line}: <{name}> has to stand before <{last}>'
        else:
            last = name


def _children(data: bytes) -> list[tuple[str, int]]:
    """Name and line of every child of the root element. Raises ExpatError."""
    parser, found, depth = expat.ParserCreate(), [], 0

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth == 2:
            found.append((name, parser.CurrentLineNumber))

    def end(name: str) -> None:
        nonlocal depth
        depth -= 1

    parser.StartElementHandler, parser.EndElementHandler = start, end
    # Expat takes positional arguments only; True: these are all of the data.
    parser.Parse(data, True)  # noqa: FBT003
    return found


CHECKS: dict[str, Callable[[Path], Iterator[str]]] = {
    'large-files': large_files,
    'private-keys': private_keys,
    'package-xml': package_xml,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one check on the files; exit code 1 when it finds something."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('check', choices=CHECKS)
    parser.add_argument('files', nargs='+', type=Path, metavar='FILE')
    options = parser.parse_args(arguments)
    faults = []
    for path in options.files:
        try:
            faults += [f'{path}: {fault}' for fault in CHECKS[options.check](path)]
        except OSError as error:
            faults.append(f'{path}: cannot be read: {error.strerror}')
    print(*faults, sep='\n', end='\n' if faults else '')
    return 1 if faults else 0


if __name__ == '__main__':
    sys.exit(main())
