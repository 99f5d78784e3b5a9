"""What reading and writing share: text in any encoding, files found whatever their case, a mesh checked for writing."""

from __future__ import annotations

import codecs
import os
import re
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import torch
from torch import Tensor

from .. import validate

_NAMING = (".obj", ".mtl", ".ply", ".gltf", ".glb", ".json", ".csv")  # files that name others
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


def read_text(path: Path) -> str:
    """The text of a file, with ``\\n`` line ends: UTF-8, UTF-16 (with or without its mark), else Latin-1."""
    data = path.read_bytes()
    encoding = next((name for mark, name in _MARKS.items() if data.startswith(mark)), "utf-8")
    if encoding == "utf-8" and b"\0" in data[:64]:
        encoding = "utf-16-be" if data[:1] == b"\0" else "utf-16-le"
    try:
        text = data.decode(encoding)
    except UnicodeDecodeError:
        text = data.decode("latin-1")  # never fails; names with accents from old Windows programs
    return text.replace("\r\n", "\n").replace("\r", "\n")


def find_file(name: str, *folders: Path) -> Path | None:
    """The file that another file calls ``name``, or None.

    Looked for in each folder as written, then by its last part alone (exporters leave paths of their own machine);
    backslashes are separators, and upper and lower case are told apart only where both exist.
    """
    parts = [part for part in name.replace("\\", "/").split("/") if part not in ("", ".")]
    for wanted in (parts, parts[-1:]) if parts else ():
        for folder in folders:
            found = _walk(folder, wanted)
            if found is not None:
                return found
    absolute = Path(name)
    return absolute if absolute.is_absolute() and absolute.is_file() else None


def _walk(folder: Path, parts: list[str]) -> Path | None:
    for part in parts:
        step = folder / part
        if not step.exists():
            entries = folder.iterdir() if folder.is_dir() else iter(())
            alike = next((entry for entry in entries if entry.name.lower() == part.lower()), None)
            if alike is None:
                return None
            step = alike
        folder = step
    return folder if folder.is_file() else None


def names_file(path: Path, other: Path, *folders: Path) -> bool:
    """Whether a mesh, its material files, or a file of cameras, name the file ``other``.

    Names are relative to the folder of the file and to ``folders``, as written or by their last part alone, with or
    without a suffix, whatever their case. What may be a name counts as one.
    """
    suffix, folders = path.suffix.lower(), (path.parent, *folders)
    if suffix not in _NAMING:
        return False
    known = other.resolve(), other.parent.resolve() / other.name  # the same unless it is a link
    wanted, stems = {str(file).lower() for file in known}, {file.stem.lower() for file in known}
    wanted |= {name.removesuffix(other.suffix.lower()) for name in wanted}
    roots = [str(folder.resolve()).lower() for folder in folders]
    for line in read_text(path).split("\n"):
        keyword, _, rest = line.strip().partition(" ")
        if suffix == ".obj" and keyword.lower() == "mtllib":
            libraries = {find_file(name.strip('"'), *folders) for name in (rest, *rest.split())}
            if any(names_file(library, other, *folders) for library in libraries if library):
                return True
        line = (unquote(line) if suffix in (".gltf", ".glb") else line).lower().replace("\\", "/")
        if any(stem in line for stem in stems):
            paths = (os.path.normpath(os.path.join(root, name)) for root in roots for name in _names(line))
            if any(named in wanted for named in paths):
                return True
    return False


def _names(line: str) -> Iterator[str]:
    """What may be the name of a file in a line: its last words, parts in quotes and between commas."""
    words = line.split()
    names = [" ".join(words[start:]).strip('"') for start in range(len(words))]
    for name in (*names, *re.findall(r'"([^"]*)"', line), *line.split(",")):
        if len(name) < 4096:  # longer ones are data
            yield from (name, os.path.basename(name))


def mesh_to_write(vertices: Any, faces: Any, textures: Any = None) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """The mesh as host arrays (float32 [V, 3], int64 [F, 3], float32 [F, T, T, T, 3] clamped to [0, 1] or None).

    Takes tensors on any device, with or without gradient, and numpy arrays. Raises TypeError or ValueError for other
    types and shapes, NaN or infinity, indices out of range, no faces, and textures of another number of faces; with
    `check_values(False)` too, since a broken file would meet somebody else.
    """
    vertices, faces = _on_host("vertices", vertices), _on_host("faces", faces)
    validate.floating("vertices", vertices, ["V", 3])
    validate.indices("faces", faces, ["F", 3])
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


def why_not_loaded(error: Exception) -> str:
    """Why torch.load failed, without its advice to load the file with less care."""
    words = str(error).strip()
    if "unsupported global" in words.lower() or "unsupported class" in words.lower():
        return "it holds other things than tensors, which could run code"
    if "Weights only load failed" in words or words.isdigit():
        return "it is none"
    return words.partition(". ")[0].splitlines()[0] if words else type(error).__name__
