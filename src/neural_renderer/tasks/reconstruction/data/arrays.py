"""The published data of single-image reconstruction as arrays in files: any amount of it, in little memory.

A folder holds, for each class and split, `{class}_{split}_images.npz` (uint8 [N, 24, 4, 64, 64]: red, green, blue and
alpha of 24 views) and `{class}_{split}_voxels.npz` (bool [N, 32, 32, 32]), and perhaps `dataset.json` with the objects'
names. An npz cannot be mapped into memory, so that each is unpacked once, piece by piece, into an npy beside it.
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
from .framing import GRID, SIZE, VIEWS

SPLITS = ("train", "val", "test")
DESCRIPTION = "dataset.json"
_PIECE = 1 << 22  # bytes
_KINDS = {"images": ("uint8", (VIEWS, 4, SIZE, SIZE)), "voxels": ("bool", (GRID,) * 3)}


@dataclass(frozen=True)
class Split:
    """The objects of one split, class by class.

    Attributes:
        folder, split: where from.
        classes: the classes' names.
        images: of each class, uint8 [N, 24, 4, 64, 64], read from the file as it is needed.
        voxels: of each class that has such a file, bool [N, 32, 32, 32], likewise.
        names: of each class, the names of its N objects.
    """

    folder: Path
    split: str
    classes: tuple[str, ...]
    images: dict[str, np.ndarray]
    voxels: dict[str, np.ndarray]
    names: dict[str, tuple[str, ...]]

    def __len__(self) -> int:
        return sum(len(images) for images in self.images.values())

    def __reduce__(self) -> Any:
        # A pickled memory map is a copy of all its numbers; another process opens the files instead.
        return open_split, (self.folder, self.split, self.classes)


def open_split(folder: str | os.PathLike[str], split: str, classes: Sequence[str] | None = None) -> Split:
    """Open a split ("train", "val" or "test") of a folder of data, by default with all its classes.

    Files that were not unpacked yet are unpacked first, beside them, or in the user's cache folder where that cannot be
    written. Several processes may do so at once.

    Raises:
        FileNotFoundError: no such folder, or no images of a class.
        ValueError: a file that is broken, cut off, or of another shape or type; another number of voxels or names than
            of images; no objects in a class, or an empty first one. The file is named.
        OSError: nowhere to unpack to, as on a full disk.
    """
    folder = Path(folder)
    if split not in SPLITS:
        raise ValueError(f"split: expected one of {', '.join(SPLITS)}, got {split!r}")
    if not folder.is_dir():
        found = "a file" if folder.exists() else "nothing there"
        raise FileNotFoundError(f"{folder}: expected a folder of {{class}}_{split}_images.npz, got {found}")
    pattern = re.compile(rf"(.+)_{split}_images\.npz")
    present = sorted(match[1] for path in folder.iterdir() if (match := pattern.fullmatch(path.name)))
    if not present:
        raise FileNotFoundError(f"{folder}: expected files {{class}}_{split}_images.npz, got none")
    chosen = tuple(dict.fromkeys(present if classes is None else classes))
    for name in chosen:
        if name not in present:
            raise FileNotFoundError(
                f"{folder / f'{name}_{split}_images.npz'}: expected the images of a class, got nothing there; "
                f"the classes are {', '.join(present)}"
            )
    if not chosen:
        raise ValueError("classes: expected at least one, got none")
    images, voxels, names = {}, {}, {}
    described = _described(folder, split)
    for name in chosen:
        path = folder / f"{name}_{split}_images.npz"
        images[name] = _opened(path, "images")
        count = len(images[name])
        if not count:
            raise ValueError(f"{path}: expected at least one object, got none")
        if not images[name][0, :, 3].any():
            raise ValueError(f"{path}: expected objects with transparency around, got images that are empty")
        solid = folder / f"{name}_{split}_voxels.npz"
        if solid.exists():
            voxels[name] = _opened(solid, "voxels")
            if len(voxels[name]) != count:
                raise ValueError(f"{solid}: expected {count} objects like {path.name}, got {len(voxels[name])}")
        given = described.get(name)
        names[name] = tuple(f"{name}-{index}" for index in range(count)) if given is None else tuple(map(str, given))
        if len(names[name]) != count:
            raise ValueError(f"{folder / DESCRIPTION}: expected {count} names of {path.name}, got {len(names[name])}")
    return Split(folder, split, chosen, images, voxels, names)


def _described(folder: Path, split: str) -> dict[str, list[str]]:
    """The names of the objects of each class, if there is a description; the published data have none."""
    path = folder / DESCRIPTION
    if not path.exists():
        return {}
    try:
        names = json.loads(path.read_text(encoding="utf-8"))["names"].get(split, {})
        return {str(name): list(rows) for name, rows in names.items()}
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(
            f'{path}: expected JSON with "names" by split and class, got another file ({reason(error)})'
        ) from None


def _opened(source: Path, kind: str) -> np.ndarray:
    """The first array of an npz, mapped from its unpacked copy."""
    copy = _unpacked(source, kind)
    dtype, trailing = _KINDS[kind]
    with contextlib.suppress(Exception):  # a copy that somebody has cut off or written over
        array = np.load(copy, mmap_mode="r")
        if array.dtype == dtype and array.ndim == 1 + len(trailing) and array.shape[1:] == trailing:
            return array
    copy.unlink()
    return np.load(_unpacked(source, kind), mmap_mode="r")


def _unpacked(source: Path, kind: str) -> Path:
    """The npy that holds what the npz holds; it has the npz's time, by which one of an older npz is told."""
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
    """Where to keep what is computed from a file: beside it, or in the user's cache folder where that is impossible."""
    beside = source.parent
    if os.access(beside, os.W_OK):
        return beside
    cache = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    folder = Path(cache) / "neural_renderer" / hashlib.sha256(str(beside.resolve()).encode()).hexdigest()[:16]
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _unpack(source: Path, kind: str, out: IO[bytes], folder: Path) -> None:
    with contextlib.ExitStack() as opened:
        with _reading(source):
            archive = opened.enter_context(zipfile.ZipFile(source))
            info = archive.infolist()[0]
            member = opened.enter_context(archive.open(info))
        shape = _checked_header(source, kind, member)
        # An npz may unpack to a thousand times its size: what does not belong there is not written anywhere.
        expected, found = math.prod(shape), info.file_size - member.tell()  # numbers of one byte
        if found != expected:
            raise ValueError(f"{source}: expected {expected} numbers as its header says, got {found}")
        if expected > shutil.disk_usage(folder).free:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        header = {"descr": np.dtype(_KINDS[kind][0]).str, "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(out, header)
        piece = b"begin"
        while piece:
            with _reading(source):
                piece = member.read(_PIECE)
            out.write(piece)


@contextlib.contextmanager
def _reading(source: Path, expected: str = "an npz, got a file that is broken or cut off") -> Iterator[None]:
    """The errors of zipfile and numpy for broken files, which are of many kinds, as ValueError."""
    try:
        yield
    except Exception as error:
        if isinstance(error, OSError) and error.filename is not None:
            raise
        raise ValueError(f"{source}: expected {expected} ({reason(error)})") from error


def _checked_header(source: Path, kind: str, member: IO[bytes]) -> tuple[int, ...]:
    """The array's shape, if it is such as the published files have."""
    dtype, trailing = _KINDS[kind]
    wanted = f"{dtype} (N, {', '.join(map(str, trailing))})"
    with _reading(source, f"{wanted}, got no array"):
        version = np.lib.format.read_magic(member)
        if version != (1, 0):  # others may have headers of any length
            raise ValueError(f"version {version} of its format")
        shape, fortran, dtype_found = np.lib.format.read_array_header_1_0(member)
    if dtype_found != np.dtype(dtype) or tuple(shape[1:]) != trailing or not shape or fortran:
        order = ", column by column" if fortran else ""
        raise ValueError(f"{source}: expected {wanted}, got {dtype_found} {short(tuple(shape))}{order}")
    return tuple(shape)
