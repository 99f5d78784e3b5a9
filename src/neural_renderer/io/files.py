"""What reading and writing share: text in any encoding, words for messages, a mesh checked for writing."""

from __future__ import annotations

import codecs
import os
import sys
import warnings
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .. import validate

_MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}


def warn(message: str) -> None:
    """A UserWarning at the line outside of this package that led here."""
    frame, level = sys._getframe(), 1
    while frame.f_back and frame.f_globals.get("__name__", "").partition(".")[0] == __name__.partition(".")[0]:
        frame, level = frame.f_back, level + 1
    warnings.warn(message, stacklevel=level)


def existing(path: str | os.PathLike[str]) -> Path:
    """``path`` if it is a file; otherwise FileNotFoundError says what was expected where."""
    if not Path(path).is_file():
        found = "a folder" if Path(path).is_dir() else "nothing there"
        raise FileNotFoundError(f"{path}: expected a file, got {found}")
    return Path(path)


def fits_float32(values: np.ndarray) -> np.ndarray:
    """Which of the numbers are finite in float32."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.isfinite(values.astype(np.float32))


def short(value: Any) -> str:
    """``value`` as a message quotes it: in quotes if it is text, and cut if it is long."""
    if isinstance(value, str):
        return repr(value if len(value) < 80 else value[:77] + "...")
    text = repr(value)
    return text if len(text) < 80 else text[:77] + "..."


def reason(error: BaseException) -> str:
    """What an error says, on one line of at most 200 characters; its kind if it says nothing."""
    return " ".join(str(error).split())[:200] or type(error).__name__


def read_bytes(path: Path) -> bytes:
    """The content of a file, up to the size that it has now: files of /proc, whose size is 0, may never end."""
    with path.open("rb") as file:
        return file.read(os.fstat(file.fileno()).st_size)


def read_text(path: Path) -> str:
    """The text of a file, with ``\\n`` line ends: UTF-8, UTF-16 (with or without its mark), else Latin-1."""
    data = read_bytes(path)
    encoding = next((name for mark, name in _MARKS.items() if data.startswith(mark)), "utf-8")
    if encoding == "utf-8" and b"\0" in data[:64]:
        encoding = "utf-16-be" if data[:1] == b"\0" else "utf-16-le"
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError:
        text = data.decode("latin-1")  # never fails; names with accents from old Windows programs
    return text.replace("\r\n", "\n").replace("\r", "\n")


def mesh_to_write(vertices: Any, faces: Any, textures: Any = None) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """The mesh as host arrays (float32 [V, 3], int64 [F, 3], float32 [F, T, T, T, 3] clamped to [0, 1] or None).

    Takes tensors on any device, with or without gradient, and numpy arrays. Raises TypeError or ValueError for other
    types and shapes, NaN or infinity, indices out of range, no faces, and textures of another number of faces; with
    `check_values(False)` too, since a broken file would meet somebody else.
    """
    vertices, faces = _on_host("vertices", vertices), _on_host("faces", faces)
    validate.floating("vertices", vertices, ["V", 3])
    faces = validate.indices("faces", faces, ["F", 3], always=True)
    if not len(faces):
        raise ValueError("faces: expected at least one, got none")
    validate.finite("vertices", vertices, always=True)
    validate.in_range("faces", faces, len(vertices), always=True)
    if textures is not None:
        textures = validate.cubes("textures", _on_host("textures", textures), len(faces))
        validate.finite("textures", textures, always=True)
        textures = textures.float().clamp(0, 1).numpy()
    return vertices.float().numpy(), faces.long().numpy(), textures


def _on_host(name: str, value: Any) -> Any:
    if isinstance(value, np.ndarray):
        value = torch.from_numpy(value.astype(np.int64) if value.dtype.kind in "iu" else np.ascontiguousarray(value))
    return validate.has_numbers(name, value).detach().cpu().resolve_neg() if isinstance(value, Tensor) else value


def load_tensors(path: str | os.PathLike[str], device: torch.device | str = "cpu") -> Any:
    """What torch.save has written: tensors and plain values; no code of the file is run.

    Raises whatever torch does (see `why_not_loaded`), and ValueError for an archive that unpacks to more than its size:
    torch compresses nothing.
    """
    if zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            if sum(member.file_size for member in archive.infolist()) > os.path.getsize(path):
                raise ValueError("it is compressed")
    return torch.load(path, map_location=device, weights_only=True)


def why_not_loaded(error: Exception) -> str:
    """Why torch.load failed, without its advice to load the file with less care."""
    words = str(error).strip()
    if "unsupported global" in words.lower() or "unsupported class" in words.lower():
        return "it holds other things than tensors, which could run code"
    if "Weights only load failed" in words or words.isdigit():
        return "it is none"
    return words.partition(". ")[0].splitlines()[0] if words else type(error).__name__
