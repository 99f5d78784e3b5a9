"""Wavefront OBJ files, written together with their material library and pictures.

The library and the pictures get names of their own beside the OBJ and carry a note of which OBJ they were written with.
A file of such a name that lacks the note was made by somebody else, and is not replaced unless that is asked for.
"""

from __future__ import annotations

import glob
import io
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image, PngImagePlugin

from .atlas import build_atlas
from .atomic_write import replacing
from .files import mesh_to_write


class Part(NamedTuple):
    """Faces that show one picture.

    Attributes:
        faces: [n] int64, their numbers.
        places: [P, 2] float64, texture coordinates.
        corners: [n, 3] int64, where in ``places`` the faces' corners are.
        picture: [H, W, 3] uint8, row 0 at the top.
        clamp: Whether the picture's border goes on beyond [0, 1], where it otherwise repeats.
    """

    faces: np.ndarray
    places: np.ndarray
    corners: np.ndarray
    picture: np.ndarray
    clamp: bool = False


def save_obj(
    filename: str | os.PathLike[str], vertices: Any, faces: Any, textures: Any = None, *, overwrite: bool = False
) -> None:
    """Write a mesh as OBJ, with its colours as MTL and PNG beside it under the same name: the first packages' function.

    `save_mesh` is the same, but calls the picture of ``spot.obj`` ``spot_texture.png``. All files are written, or none.

    Args:
        filename: Ends in ``.obj``; missing folders are made.
        vertices: [V, 3] float tensor or array, on any device; written so that float32 is read back exactly.
        faces: [F, 3], whole numbers of any real dtype.
        textures: [F, T, T, T, 3] in [0, 1] (clamped), or None. Each face gets a tile of 15 × 15 to
            50 × 50 pixels (fewer above 290,000 faces) in the PNG, which holds what the renderer shows of its cube.
        overwrite: Replace an MTL and a PNG of these names whoever made them; otherwise only those that were written
            with ``filename`` before.

    Raises:
        TypeError, ValueError: As told for each argument; another suffix; too many faces for one picture.
        FileExistsError: The MTL or the PNG would replace a file that was not written with ``filename``.
        OSError: The files cannot be written. What was there before stays.
    """
    path = Path(filename)
    if path.suffix.lower() != ".obj":
        raise ValueError(f"filename: expected a name that ends in .obj, got {path.name!r}")
    save_cubes(path, vertices, faces, textures, path.stem, overwrite)


def save_cubes(path: Path, vertices: Any, faces: Any, textures: Any, texture: str, overwrite: bool) -> None:
    """`save_obj` with the name of the picture, without its suffix."""
    points, corners, cubes = mesh_to_write(vertices, faces, textures)
    parts = []
    if cubes is not None:
        picture, pixels = build_atlas(cubes)
        height, width = picture.shape[:2]
        places = pixels.reshape(-1, 2) / [width - 1, height - 1] * [1, -1] + [0, 1]
        every = np.arange(len(corners))
        parts = [Part(every, places, np.arange(len(places)).reshape(-1, 3), picture)]
    write_obj(path, points, corners, parts, texture, overwrite)


def write_obj(
    path: Path, points: np.ndarray, corners: np.ndarray, parts: list[Part], texture: str, overwrite: bool
) -> None:
    """Write an OBJ, its MTL, and a PNG for each part: ``{texture}.png``, or ``{texture}_1.png`` and so on.

    ``points`` [V, 3], ``corners`` [F, 3]; without parts there is neither MTL nor PNG. Errors as `save_obj`.
    """
    numbers = [""] if len(parts) == 1 else [f"_{number}" for number in range(1, len(parts) + 1)]
    pictures = [f"{texture}{number}.png" for number in numbers]
    library = f"{path.stem}.mtl"
    if parts and not overwrite:
        check_own(path, [path.with_name(name) for name in (library, *pictures)], "overwrite=True replaces it")
    text = [f"# {path.name}\n#\n\n"]
    if parts:
        text.append(f"mtllib {library}\n\n")
    text.append(_lines("v %.9g %.9g %.9g\n", points))
    if not parts:
        text.append("\n" + _lines("f %d %d %d\n", corners + 1))
    first = 1
    for number, part in enumerate(parts, 1):
        text.append("\n" + _lines("vt %.9g %.9g\n", part.places) + f"\nusemtl material_{number}\n")
        both = np.stack([corners[part.faces] + 1, part.corners + first], axis=2)
        text.append(_lines("f %d/%d %d/%d %d/%d\n", both.reshape(-1, 6)))
        first += len(part.places)
    with replacing(path) as fresh:
        fresh.write_text("".join(text), encoding="utf-8")
        if parts:
            materials = [_material(number, *shown) for number, shown in enumerate(zip(pictures, parts, strict=True), 1)]
            fresh.with_name(library).write_text("\n".join([f"# {_note(path)}", *materials]), encoding="utf-8")
        for name, part in zip(pictures, parts, strict=True):
            fresh.with_name(name).write_bytes(_png(part.picture, _note(path)))


def _material(number: int, picture: str, part: Part) -> str:
    """The material ``material_<number>`` of an MTL file, which shows a picture as it is."""
    option = "-clamp on " if part.clamp else ""
    return f"newmtl material_{number}\nKa 1 1 1\nKd 1 1 1\nKs 0 0 0\nd 1\nillum 1\nmap_Kd {option}{picture}\n"


def _lines(form: str, rows: np.ndarray) -> str:
    return (form * len(rows)) % tuple(rows.reshape(-1).tolist())


def _png(picture: np.ndarray, note: str) -> bytes:
    kept, file = PngImagePlugin.PngInfo(), io.BytesIO()
    kept.add_text("Comment", note)
    Image.fromarray(picture).save(file, "PNG", pnginfo=kept)
    return file.getvalue()


def _note(path: Path) -> str:
    return f"written by neural_renderer with {path.name}"


def check_own(path: Path, files: Iterable[Path] | None, advice: str) -> None:
    """Raise FileExistsError if a file was not written with the OBJ at ``path``; it ends with ``advice``.

    ``files`` may exist or not; None means all that `save_mesh` or `UVMesh.save` could write beside ``path``.
    """
    if files is None:
        names = (f"{glob.escape(path.stem)}_texture{number}.png" for number in ("", "_[0-9]*"))
        files = [path.with_suffix(".mtl"), *(file for name in names for file in path.parent.glob(name))]
    for file in files:
        if file.exists() and not _is_own(path, file):
            raise FileExistsError(
                f"{file}: expected nothing there, or a file that was written with {path.name}, got another; {advice}"
            )


def _is_own(path: Path, file: Path) -> bool:
    """Whether a library or picture was written with the OBJ at ``path``, by us or by the first packages."""
    if not file.is_file():
        return False
    library = path.with_suffix(".mtl")
    text = library.read_text(encoding="utf-8", errors="replace") if library.is_file() else ""
    if text == f"newmtl material_1\nmap_Kd {path.stem}.png\n":  # theirs has no note
        return file in (library, path.with_suffix(".png"))
    if file == library:
        return text.startswith(f"# {_note(path)}\n")
    try:
        with Image.open(file) as picture:
            return picture.info.get("Comment") == _note(path)
    except Exception:  # Pillow's errors for broken files are of many kinds
        return False
