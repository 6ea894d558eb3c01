"""What bundles, teachers, checkpoints and caches share: atomic writing of files and folders, hashes, permissions, and
half-precision weights.

Everything is written next to its target under a name that ends in `.partial` and then renamed, so that a reader never
sees a half-written artifact, even when the writer is killed.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from raw2drive_ros.contracts.errors import UserError

if TYPE_CHECKING:
    from torch import Tensor

WEIGHTS = 'weights.safetensors'
CARD = 'MODEL_CARD.md'
MAX_WEIGHT_BYTES = 2_000_000_000
LEFT_BEHIND_S = 24 * 3600.0


def short_hash(data: bytes) -> str:
    """The first 16 hex digits of SHA-256."""
    return hashlib.sha256(data).hexdigest()[:16]


def partial_name(target: Path) -> Path:
    """Temporary path for writing `target`. It contains the process id, so that concurrent writers do not collide."""
    return target.with_name(f'.{target.name}.{os.getpid()}.partial')


def write_whole(target: Path, content: str | bytes) -> Path:
    """Write a file atomically: it holds either all of `content` or what it held before."""
    partial = partial_name(target)
    partial.write_bytes(content.encode() if isinstance(content, str) else content)
    return partial.replace(target)


@contextmanager
def whole_folder(target: Path, *, keep_existing: bool = False) -> Iterator[Path]:
    """Yields an empty folder to fill, which replaces `target` if the block ends without an error, else is deleted.

    A link to a folder stays a link. keep_existing: for what has the same content whoever writes it; a folder that
    another process finished meanwhile stays, because somebody may be reading it. Raises NotADirectoryError, before
    anything is written, where `target` is a file.
    """
    target = target.resolve() if target.is_symlink() else target
    if target.exists() and not target.is_dir():
        raise NotADirectoryError(f'{target}: is a file, and a folder is to be written there')
    partial = partial_name(target)
    _sweep(target)
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    try:
        yield partial
        if keep_existing:
            _place(partial, target)
        else:
            _swap(partial, target)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _swap(partial: Path, target: Path) -> None:
    old = _old_name(target)
    restore_folder(target)
    if target.exists():
        target.replace(old)
    partial.replace(target)
    shutil.rmtree(old, ignore_errors=True)


def _place(partial: Path, target: Path) -> None:
    try:
        partial.replace(target)
    except OSError:
        # Renaming onto a folder that holds something fails: the other process was first.
        if not target.is_dir():
            raise


def _sweep(target: Path) -> None:
    """Delete what killed writers of `target` left long ago; a younger one may belong to another machine's process."""
    for left in target.parent.glob(f'.{target.name}.*.partial'):
        with suppress(FileNotFoundError):
            # Its writer may finish at this moment.
            if time.time() - left.stat().st_mtime > LEFT_BEHIND_S:
                shutil.rmtree(left, ignore_errors=True)


def restore_folder(target: Path) -> None:
    """Repair a kill between the two renames of `whole_folder`: the previous folder becomes `target` again."""
    old = _old_name(target)
    if old.is_dir() and not target.exists():
        old.replace(target)
    shutil.rmtree(old, ignore_errors=True)


def _old_name(target: Path) -> Path:
    return target.with_name(f'.{target.name}.old')


def save_weights(folder: Path, tensors: Mapping[str, Tensor]) -> str:
    """Write `WEIGHTS` as float16 and return its hash. World-readable, because bundles are meant to be shared."""
    from safetensors.torch import save_file

    file = folder / WEIGHTS
    save_file({key: value.detach().clone().half().contiguous() for key, value in tensors.items()}, file)
    file.chmod(0o644)
    return short_hash(file.read_bytes())


def load_weights(folder: Path, expected_hash: str, error: type[UserError]) -> dict[str, Tensor]:
    """`WEIGHTS` as float32. Raises `error` when the file is too large or its hash is not `expected_hash`."""
    from safetensors.torch import load_file

    file = folder / WEIGHTS
    if file.stat().st_size > MAX_WEIGHT_BYTES:
        raise error(f'{folder}: weights of {file.stat().st_size} bytes are implausible')
    if short_hash(file.read_bytes()) != expected_hash:
        raise error(f'{folder}: weights do not match their hash; the file is damaged or replaced')
    return {key: value.float() for key, value in load_file(file).items()}


def part_of(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """The tensors whose names begin with `prefix/`, under the rest of their names."""
    return {key.removeprefix(f'{prefix}/'): value for key, value in tensors.items() if key.startswith(f'{prefix}/')}


def check_manifest(
    path: Path, body: Mapping[str, Any], kind: str, format_read: int, hashes: Mapping[str, str], error: type[UserError]
) -> None:
    """Raises `error` unless the manifest has format `format_read` and our `hashes` (name -> value of this version)."""
    if body['format'] != format_read:
        raise error(f'{path}: {kind} format {body["format"]}, this version reads {format_read}')
    for name, ours in hashes.items():
        if body[name] != ours:
            raise error(f'{path}: {name} hash {body[name]} differs from this version: {ours}')


def model_card(title: str, purpose: str, figures: list[str], metadata: Mapping[str, Any]) -> str:
    """The text of `CARD`. Lists in the metadata are shown by their length only; the manifest holds them in full."""
    shown = {key: len(value) if isinstance(value, list) else value for key, value in metadata.items()}
    lines = [f'# {title}', '', purpose, '', *(f'- {figure}' for figure in figures)]
    lines += [f'- {key}: {value}' for key, value in shown.items()]
    lines += ['', 'Made in and for the highway-env simulation of this repository; not for real roads.', '']
    return '\n'.join(lines)
