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

from raw2drive_ros.bounds import MAX_WEIGHT_BYTES, MIB, BoundedFile, tensor_shapes
from raw2drive_ros.contracts.errors import NonFiniteError, UserError

if TYPE_CHECKING:
    from torch import Tensor

WEIGHTS = 'weights.safetensors'
CARD = 'MODEL_CARD.md'
LEFT_BEHIND_S = 24 * 3600.0


def short_hash(data: bytes) -> str:
    """The first 16 hex digits of SHA-256."""
    return hashlib.sha256(data).hexdigest()[:16]


def hash_of_file(path: Path) -> str:
    """SHA-256 of a regular file, in hex, without holding it in memory. Raises OSError."""
    digest = hashlib.sha256()
    with BoundedFile(path, MIB) as file:
        while part := file.read(MIB):
            digest.update(part)
    return digest.hexdigest()


def partial_name(target: Path) -> Path:
    """Temporary path for writing `target`. It contains the process id, so that concurrent writers do not collide."""
    return target.with_name(f'.{target.name}.{os.getpid()}.partial')


def write_whole(target: Path, content: str | bytes, *, durable: bool = False) -> Path:
    """Write a file atomically: it holds either all of `content` or what it held before.

    durable: also after a loss of power; it is on the disk when this returns.
    """
    partial = partial_name(target)
    partial.write_bytes(content.encode() if isinstance(content, str) else content)
    if durable:
        _sync(partial)
    partial.replace(target)
    if durable:
        _sync(target.parent)
    return target


def _sync(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextmanager
def whole_folder(target: Path, *, keep_existing: bool = False, durable: bool = False) -> Iterator[Path]:
    """Yields an empty folder to fill, which replaces `target` if the block ends without an error, else is deleted.

    A link to a folder stays a link. keep_existing: for what has the same content whoever writes it; a folder that
    another process finished meanwhile stays, because somebody may be reading it. durable: it is on the disk, whole,
    when the block has ended, also after a loss of power. Raises NotADirectoryError, before anything is written, where
    `target` is a file.
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
        if durable:
            # Before it gets its name: a name without content would pass for the whole.
            for path in [*partial.rglob('*'), partial]:
                _sync(path)
        if keep_existing:
            _place(partial, target)
        else:
            _swap(partial, target)
        if durable:
            _sync(target.parent)
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
    """Write `WEIGHTS` as float16 and return its hash. World-readable, because bundles are meant to be shared.

    Raises NonFiniteError for weights that are not finite, or not as float16.
    """
    from safetensors.torch import save_file

    file = folder / WEIGHTS
    halves = {key: value.detach().clone().half().contiguous() for key, value in tensors.items()}
    if bad := not_finite(halves):
        raise NonFiniteError(f'{folder.name}: {bad} holds values that are not finite as float16')
    save_file(halves, file)
    file.chmod(0o644)
    return hash_of_file(file)[:16]


def load_weights(folder: Path, expected_hash: str, error: type[UserError]) -> dict[str, Tensor]:
    """`WEIGHTS` as float32. Raises `error` when the file is too large, its hash is not `expected_hash`, or a weight is
    not finite."""
    from safetensors.torch import load_file

    file = folder / WEIGHTS
    try:
        tensor_shapes(file, MAX_WEIGHT_BYTES)
        if hash_of_file(file)[:16] != expected_hash:
            raise error(f'{folder}: weights do not match their hash; the file is damaged or replaced')
    except (OSError, ValueError) as reason:
        if isinstance(reason, error):
            raise
        said = reason.strerror if isinstance(reason, OSError) else reason
        # Damage to the header damages the hash too.
        raise error(f'{folder}: {WEIGHTS}: {said}; weights do not match their hash') from reason
    tensors = {key: value.float() for key, value in load_file(file).items()}
    if bad := not_finite(tensors):
        raise error(f'{folder}: {bad} holds weights that are not finite')
    return tensors


def not_finite(tensors: Mapping[str, Tensor]) -> str:
    """The name of the first tensor that holds a NaN or an infinity, or ''."""
    return next(
        (name for name, value in tensors.items() if value.is_floating_point() and not value.isfinite().all()), ''
    )


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
