"""Helpers of readers and writers: text in any encoding, parts of messages, checks of meshes before writing."""

from __future__ import annotations

import codecs
import os
import sys
import textwrap
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..base import validate
from ..base.requirements import existing as existing
from ..base.requirements import import_library as import_library
from ..base.requirements import short_path as short_path

_BYTE_ORDER_MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
_LONGEST_QUOTE, _LONGEST_REASON = 80, 400  # characters


def warn(message: str) -> None:
    """Issue a UserWarning that points to the line outside of this package that called it."""
    frame, level = sys._getframe(), 1
    while frame.f_back and frame.f_globals.get("__name__", "").partition(".")[0] == __name__.partition(".")[0]:
        frame, level = frame.f_back, level + 1
    warnings.warn(message, stacklevel=level)


def fits_float32(values: np.ndarray) -> np.ndarray:
    """Test which numbers are finite in float32."""
    with np.errstate(over="ignore", invalid="ignore"):
        return np.isfinite(values.astype(np.float32))


def short(value: Any) -> str:
    """Format ``value`` for a message: text in quotes, long values cut."""

    def cut(text: str) -> str:
        return text if len(text) < _LONGEST_QUOTE else text[: _LONGEST_QUOTE - 3] + "..."

    return repr(cut(value)) if isinstance(value, str) else cut(repr(value))


def reason(error: BaseException) -> str:
    """Return an error's message on one line, cut after a word if it is long; the error's class if it has no message."""
    return textwrap.shorten(str(error), _LONGEST_REASON, placeholder=" …") or type(error).__name__


def read_bytes(path: Path) -> bytes:
    """Read a file up to its present size. Files in /proc have size 0 and may be endless."""
    with path.open("rb") as file:
        return file.read(os.fstat(file.fileno()).st_size)


def read_text(path: Path) -> str:
    """Read text in UTF-8, UTF-16 (with or without byte order mark) or else Latin-1; line ends become ``\\n``."""
    data = read_bytes(path)
    encoding = next((name for mark, name in _BYTE_ORDER_MARKS.items() if data.startswith(mark)), "utf-8")
    if encoding == "utf-8" and b"\0" in data[:64]:
        encoding = "utf-16-be" if data[:1] == b"\0" else "utf-16-le"
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError:
        text = data.decode("latin-1")  # used by old Windows programs; decoding it never fails
    return text.replace("\r\n", "\n").replace("\r", "\n")


def mesh_to_write(vertices: Any, faces: Any, textures: Any = None) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Convert a mesh, as `save_mesh` takes it, to arrays on the CPU and check it, even with `check_values(False)`.

    Returns vertices float32, faces int64, and textures float32, clamped to [0, 1], or None.
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


def as_tensor(value: Any) -> Any:
    """Convert an array, or nested lists of numbers, to a tensor; return other values unchanged."""
    array = value
    if isinstance(value, (list, tuple)):
        try:
            array = np.asarray(value)
        except (TypeError, ValueError, RuntimeError):  # rows of different lengths, or tensors that need gradients
            return value
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "biuf":
        return value
    return torch.from_numpy(np.ascontiguousarray(array, array.dtype.newbyteorder("=")))


def _on_host(name: str, value: Any) -> Any:
    """Convert an array or a tensor to a detached tensor on the CPU; return other values unchanged."""
    value = as_tensor(value)
    return validate.has_numbers(name, value).detach().cpu().resolve_neg() if isinstance(value, Tensor) else value
