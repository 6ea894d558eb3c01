"""The folder for this user's lock and key files: nobody else may read it, write to it, or put a link in its place."""

from __future__ import annotations

import os
import stat
from pathlib import Path

from raw2drive_ros.contracts.errors import RuntimeFolderError

NAME = 'raw2drive'
# Not TMPDIR, which may differ between the processes of one user, who have to find the same files.
TEMPORARY = Path('/tmp')


def runtime_folder(temporary: Path = TEMPORARY) -> Path:
    """`$XDG_RUNTIME_DIR/raw2drive`, or else `raw2drive-<user id>` in `temporary`; made with mode 0700 where missing.

    XDG_RUNTIME_DIR counts where it is a folder of this user: after `su` it may still name another user's. Raises
    RuntimeFolderError for a link, for what is no folder, for another owner, and for a folder that others may use.
    """
    path = _session_folder() or temporary / f'{NAME}-{os.geteuid()}'
    try:
        path.mkdir(mode=0o700, exist_ok=True)
        # After mkdir, and without following links: whoever was there first has made it.
        found = path.lstat()
    except OSError as error:
        raise RuntimeFolderError(f'cannot make the runtime folder {path}: {error.strerror}') from error
    if stat.S_ISLNK(found.st_mode):
        raise RuntimeFolderError(f'{path} is a link; it has to be a folder of yours: remove it')
    if found.st_uid != os.geteuid():
        raise RuntimeFolderError(
            f'{path} belongs to another user (id {found.st_uid}): remove it, or set XDG_RUNTIME_DIR'
        )
    if found.st_mode & 0o077:
        raise RuntimeFolderError(f'{path} is open to other users: look at what is in it, then chmod 700 {path}')
    return path


def _session_folder() -> Path | None:
    given = Path(os.environ.get('XDG_RUNTIME_DIR', ''))
    try:
        usable = given.is_absolute() and given.is_dir() and given.stat().st_uid == os.geteuid()
    except OSError:
        usable = False
    return given / NAME if usable else None
