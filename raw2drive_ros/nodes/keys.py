"""The key with which gate, planner and vehicle sign their messages: a file that only its user can read."""

from __future__ import annotations

import os
import secrets
import stat
from pathlib import Path

from msg_adapters.signatures import KEY_BYTES
from raw2drive_ros.contracts.errors import KeyFileError
from raw2drive_ros.runtime_folder import runtime_folder

# Given by a launcher whose nodes shall not share a key with other graphs of the domain.
KEY_VARIABLE = 'RAW2DRIVE_KEY_FILE'


def key_file(domain: int) -> Path:
    """`$RAW2DRIVE_KEY_FILE`, or the file of the ROS domain in the user's runtime folder. Raises RuntimeFolderError."""
    given = os.environ.get(KEY_VARIABLE)
    return Path(given) if given else runtime_folder() / f'domain_{domain}.key'


def load_key(domain: int) -> bytes:
    """The key of this user's graphs in the domain; made where there is none.

    Nodes that are started one by one find the same file, in whatever order. Raises KeyFileError for a file that others
    may read or write, a link, or one that is no key, and RuntimeFolderError.
    """
    path = key_file(domain)
    try:
        return _read(path)
    except FileNotFoundError:
        _make(path)
        return _read(path)


def _read(path: Path) -> bytes:
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError:
        raise
    except OSError as error:
        raise KeyFileError(f'{path}: cannot be read as a key: {error.strerror}') from error
    try:
        found = os.fstat(handle)
        if not stat.S_ISREG(found.st_mode) or found.st_uid != os.geteuid() or found.st_mode & 0o077:
            raise KeyFileError(
                f'{path}: a key has to be a file of yours that nobody else may use: chmod 600, or remove it'
            )
        data = os.read(handle, KEY_BYTES + 1)
    finally:
        os.close(handle)
    if len(data) != KEY_BYTES:
        raise KeyFileError(f'{path}: not a key of {KEY_BYTES} bytes: remove it, and end the nodes that use it')
    return data


def _make(path: Path) -> None:
    """Write a new key beside the name and link it there: whoever looks sees none or a whole one, and only one wins."""
    part = path.with_name(f'.{path.name}.{os.getpid()}.{secrets.token_hex(4)}')
    try:
        handle = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
        try:
            os.write(handle, secrets.token_bytes(KEY_BYTES))
        finally:
            os.close(handle)
        try:
            os.link(part, path)
        except FileExistsError:
            pass
        finally:
            part.unlink()
    except OSError as error:
        raise KeyFileError(f'{path}: cannot make a key: {error.strerror}') from error
