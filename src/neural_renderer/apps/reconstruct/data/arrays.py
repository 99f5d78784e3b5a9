"""Data sets in the published format as memory-mapped arrays.

A folder contains, for each class and split, ``{class}_{split}_images.npz`` (uint8 [N, 24, 4, 64, 64], RGBA of 24 views)
and ``{class}_{split}_voxels.npz`` (bool [N, 32, 32, 32]), and optionally ``dataset.json`` with the names of objects.
An npz cannot be memory-mapped; it is unpacked once into an npy in the same folder.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import math
import os
import re
import shutil
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np

from ....io.atomic_write import replacing
from ....io.files import reason, short
from .framing import GRID, SIZE, SPLITS, VIEWS
from .shard_images import is_shards, open_shards

DESCRIPTION = "dataset.json"
_CHUNK = 1 << 22  # bytes unpacked in a step
_KINDS = {"images": ("uint8", (VIEWS, 4, SIZE, SIZE)), "voxels": ("bool", (GRID,) * 3)}  # dtype, shape of an object


@dataclass(frozen=True)
class Split:
    """Objects of one split, by class."""

    folder: Path
    split: str  # "train", "val" or "test"
    classes: tuple[str, ...]
    images: dict[str, Any]  # class → uint8 [N, 24, 4, 64, 64], memory-mapped, or read from shards (`ShardImages`)
    voxels: dict[str, np.ndarray]  # class → bool [N, 32, 32, 32], memory-mapped; classes without voxels are missing
    names: dict[str, tuple[str, ...]]  # class → names of its N objects

    def __len__(self) -> int:
        return sum(len(images) for images in self.images.values())

    def __reduce__(self) -> Any:
        # Pickling a memory map copies its data; another process opens the files instead.
        return open_split, (self.folder, self.split, self.classes)


def open_split(folder: str | os.PathLike[str], split: str, classes: Sequence[str] | None = None) -> Split:
    """Open a split, "train", "val" or "test", with some of its classes or, by default, all.

    The folder is in the published format, or a data set of `neural-renderer dataset` (see `shard_images.open_shards`).
    Files are unpacked at first use: beside the npz, or in the user's cache folder if that is not writable. Several
    processes may do this at the same time. ValueError: A file is broken, truncated, or of a wrong shape or dtype;
    numbers of voxels, names and images differ; or a class is empty.
    """
    folder = Path(folder)
    if split not in SPLITS:
        raise ValueError(f"split: expected one of {', '.join(SPLITS)}, got {split!r}")
    if not folder.is_dir():
        found = "a file" if folder.exists() else "nothing there"
        raise FileNotFoundError(f"{folder}: expected a folder of {{class}}_{split}_images.npz, got {found}")
    if is_shards(folder):
        return _open_shards(folder, split, classes)
    present = _classes(folder, split)
    if not present:
        raise FileNotFoundError(f"{folder}: expected files {{class}}_{split}_images.npz, got none")
    selected = tuple(dict.fromkeys(present if classes is None else classes))
    for name in selected:
        if name not in present:
            raise FileNotFoundError(
                f"{folder / f'{name}_{split}_images.npz'}: expected the images of a class, got nothing there; "
                f"the classes are {', '.join(present)}"
            )
    if not selected:
        raise ValueError("classes: expected at least one, got none")
    images, voxels, names = {}, {}, {}
    described = _read_names(folder, split)
    for name in selected:
        path = folder / f"{name}_{split}_images.npz"
        images[name] = _open_array(path, "images")
        count = len(images[name])
        if not count:
            raise ValueError(f"{path}: expected at least one object, got none")
        if not images[name][0, :, 3].any():
            raise ValueError(f"{path}: expected images of objects, got images that are fully transparent")
        voxel_path = folder / f"{name}_{split}_voxels.npz"
        if voxel_path.exists():
            voxels[name] = _open_array(voxel_path, "voxels")
            if len(voxels[name]) != count:
                raise ValueError(f"{voxel_path}: expected {count} objects like {path.name}, got {len(voxels[name])}")
        given = described.get(name)
        names[name] = tuple(f"{name}-{index}" for index in range(count)) if given is None else tuple(map(str, given))
        if len(names[name]) != count:
            raise ValueError(f"{folder / DESCRIPTION}: expected {count} names of {path.name}, got {len(names[name])}")
    return Split(folder, split, selected, images, voxels, names)


def classes_of(folder: str | os.PathLike[str], split: str) -> list[str]:
    """List the classes that a split of a data set has; none if there is no such split."""
    folder = Path(folder)
    return sorted(open_shards(folder)[0].get(split, {})) if is_shards(folder) else _classes(folder, split)


def _classes(folder: Path, split: str) -> list[str]:
    pattern = re.compile(rf"(.+)_{split}_images\.npz")
    return sorted(match[1] for path in folder.iterdir() if (match := pattern.fullmatch(path.name)))


def _open_shards(folder: Path, split: str, classes: Sequence[str] | None) -> Split:
    """Open a split of the views in shards; arguments and errors as `open_split`."""
    all_images, all_names = open_shards(folder)
    images, names = all_images.get(split, {}), all_names.get(split, {})
    selected = tuple(dict.fromkeys(sorted(images) if classes is None else classes))
    missing = [name for name in selected if name not in images]
    if missing or not selected:
        raise FileNotFoundError(
            f"{folder}: expected {missing[0] if missing else 'models'} in the split {split}, got none; the classes are "
            f"{', '.join(sorted(images)) or 'none'}"
        )
    return Split(folder, split, selected, {n: images[n] for n in selected}, {}, {n: names[n] for n in selected})


def _read_names(folder: Path, split: str) -> dict[str, list[str]]:
    """Read the names of objects by class; the published data set has none."""
    path = folder / DESCRIPTION
    if not path.exists():
        return {}
    try:
        names = json.loads(path.read_text(encoding="utf-8"))["names"].get(split, {})
        return {str(name): list(rows) for name, rows in names.items()}
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(f'{path}: expected JSON with "names" by split and class, got {reason(error)}') from None


def _open_array(source: Path, kind: str) -> np.ndarray:
    """Memory-map the first array of an npz from its unpacked copy."""
    copy = _unpacked_copy(source, kind)
    dtype, trailing = _KINDS[kind]
    with contextlib.suppress(Exception):  # the copy is truncated or overwritten
        array = np.load(copy, mmap_mode="r")
        if array.dtype == dtype and array.ndim == 1 + len(trailing) and array.shape[1:] == trailing:
            return array
    copy.unlink()
    return np.load(_unpacked_copy(source, kind), mmap_mode="r")


def _unpacked_copy(source: Path, kind: str) -> Path:
    """Find or make the unpacked copy of an npz. It is up to date if it has the modification time of the npz."""
    stamp = source.stat().st_mtime_ns
    folder = cache_folder(source)
    for target in (source.with_suffix(".npy"), folder / f"{source.stem}.npy"):
        if target.is_file() and target.stat().st_mtime_ns == stamp:
            return target
    with replacing(target) as fresh:
        with fresh.open("wb") as out:
            _unpack(source, kind, out, folder)
        os.utime(fresh, ns=(stamp, stamp))
    return target


def cache_folder(source: Path) -> Path:
    """Choose a folder for files derived from ``source``: its folder if writable, else one in the user's cache."""
    home = source.parent
    if os.access(home, os.W_OK):
        return home
    cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(cache) / "neural_renderer" / hashlib.sha256(str(home.resolve()).encode()).hexdigest()[:16]
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _unpack(source: Path, kind: str, out: IO[bytes], folder: Path) -> None:
    """Write the first array of an npz to ``out``, an npy file in ``folder``."""
    with contextlib.ExitStack() as opened:
        with _reading(source):
            archive = opened.enter_context(zipfile.ZipFile(source))
            info = archive.infolist()[0]
            member = opened.enter_context(archive.open(info))
        shape = _checked_header(source, kind, member)
        # An npz may unpack to a thousand times its size. Sizes are checked before anything is written.
        expected, found = math.prod(shape), info.file_size - member.tell()  # numbers of one byte
        if found != expected:
            raise ValueError(f"{source}: expected {expected} numbers according to its header, got {found}")
        if expected > shutil.disk_usage(folder).free:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        header = {"descr": np.dtype(_KINDS[kind][0]).str, "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(out, header)
        chunk = b"start"
        while chunk:
            with _reading(source):
                chunk = member.read(_CHUNK)
            out.write(chunk)


@contextlib.contextmanager
def _reading(source: Path, expected: str = "an npz, got a file that is broken or truncated") -> Iterator[None]:
    """Convert errors of zipfile and numpy on damaged files, which have many classes, to ValueError."""
    try:
        yield
    except Exception as error:
        if isinstance(error, OSError) and error.filename is not None:
            raise
        raise ValueError(f"{source}: expected {expected} ({reason(error)})") from error


def _checked_header(source: Path, kind: str, member: IO[bytes]) -> tuple[int, ...]:
    """Read the shape of an array; raise ValueError unless dtype and shape are those of the published data set."""
    dtype, trailing = _KINDS[kind]
    wanted = f"{dtype} (N, {', '.join(map(str, trailing))})"
    with _reading(source, f"{wanted}, got no array"):
        version = np.lib.format.read_magic(member)
        if version != (1, 0):  # other versions may have headers of any length
            raise ValueError(f"version {version} of its format")
        shape, fortran, dtype_found = np.lib.format.read_array_header_1_0(member)
    if dtype_found != np.dtype(dtype) or tuple(shape[1:]) != trailing or not shape or fortran:
        order = " in Fortran order" if fortran else ""
        raise ValueError(f"{source}: expected {wanted}, got {dtype_found} {short(tuple(shape))}{order}")
    return tuple(shape)
