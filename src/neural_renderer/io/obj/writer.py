"""Writing of Wavefront OBJ files with a material library (MTL) and images (PNG).

MTL and PNG files contain a note with the name of their OBJ. A file without this note is foreign; it is only replaced
with ``overwrite=True``.
"""

from __future__ import annotations

import glob
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ..atlas import build_atlas
from ..atomic_write import replacing
from ..files import mesh_to_write
from ..image_formats.pictures import open_picture
from ..image_formats.png import encode_png
from .mtl import statements


class Part(NamedTuple):
    """Faces with a common image.

    ``material`` has the arguments of a `Material`, with a `FileTexture` for each texture; it is empty for a matt one.
    """

    faces: np.ndarray  # [n] int64, indices of the faces
    places: np.ndarray  # [P, 2] float64, texture coordinates, v up
    corners: np.ndarray  # [n, 3] int64, indices into ``places`` of the faces' corners
    picture: np.ndarray | None  # [H, W, 3] uint8, row 0 at the top
    clamp: bool = False  # the border continues beyond [0, 1]; otherwise the picture repeats
    material: dict[str, Any] = {}  # noqa: RUF012 (never changed)
    color: tuple[float, float, float] = (1.0, 1.0, 1.0)  # sRGB of the faces if there is no picture
    normals: np.ndarray | None = None  # [n, 3, 3]


def save_obj(
    filename: str | os.PathLike[str], vertices: Any, faces: Any, textures: Any = None, *, overwrite: bool = False
) -> None:
    """Write a mesh as OBJ, with ``spot.mtl`` and ``spot.png`` beside ``spot.obj``, as the first packages do.

    New code uses `save_mesh`, which calls the image ``spot_texture.png``. All files are written, or none.

    Args:
        filename: Name that ends in ``.obj``. Missing folders are made.
        vertices, faces, overwrite: As in `save_mesh`. float32 is read back exactly.
        textures: [F, T, T, T, 3] floating, clamped to [0, 1]; or None. Each face gets a tile of 15 × 15 to 50 × 50
            pixels in the PNG, fewer above 290,000 faces.

    Raises:
        TypeError, ValueError, FileExistsError, OSError: As `save_mesh`, or there are too many faces for one image.

    Example:
        >>> vertices, faces = nr.cube()
        >>> nr.save_obj("cube.obj", vertices, faces, torch.ones(12, 1, 1, 1, 3))
    """
    path = Path(filename)
    if path.suffix.lower() != ".obj":
        raise ValueError(f"filename: expected a name that ends in .obj, got {path.name!r}")
    save_cubes(path, vertices, faces, textures, path.stem, overwrite)


def save_cubes(path: Path, vertices: Any, faces: Any, textures: Any, texture: str, overwrite: bool) -> None:
    """Write a mesh with texture cubes; ``texture`` is the name of the image without suffix. See `save_obj`."""
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
    """Write an OBJ, its MTL, and a PNG for each part; errors as `save_obj`. Without parts there is neither MTL nor PNG.

    ``texture`` is the name of the image without suffix; several images are called ``{texture}_1.png`` and so on.
    """
    if parts and (not path.stem.isprintable() or "\\" in path.stem):  # such a name breaks the line of `mtllib`
        raise ValueError(f"path: expected a name that an OBJ file can hold, got {path.name!r}")
    library = f"{path.stem}.mtl"
    names, materials, pictures = _materials(parts, texture)
    if parts and not overwrite:
        check_own(path, [path.with_name(name) for name in (library, *pictures)], "overwrite=True replaces it")
    text = [f"# {path.name}\n#\n\n"]
    if parts:
        text.append(f"mtllib {library}\n\n")
    text.append(_lines("v %.9g %.9g %.9g\n", points))
    if not parts:
        text.append("\n" + _lines("f %d %d %d\n", corners + 1))
    first = normal = 1
    for name, part in zip(names, parts, strict=True):
        text.append("\n" + _lines("vt %.9g %.9g\n", part.places))
        both = np.stack([corners[part.faces] + 1, part.corners + first], axis=2)
        form = "f %d/%d %d/%d %d/%d\n"
        if part.normals is not None:
            known, index = np.unique(part.normals.reshape(-1, 3), axis=0, return_inverse=True)
            text.append(_lines("vn %.9g %.9g %.9g\n", known))
            both = np.concatenate([both, index.reshape(-1, 3, 1) + normal], axis=2)
            form, normal = "f %d/%d/%d %d/%d/%d %d/%d/%d\n", normal + len(known)
        text.append(f"\nusemtl {name}\n")
        text.append(_lines(form, both.reshape(len(both), -1)))
        first += len(part.places)
    with replacing(path) as fresh:
        fresh.write_text("".join(text), encoding="utf-8")
        if parts:
            fresh.with_name(library).write_text("\n".join([f"# {_note(path)}", *materials]), encoding="utf-8")
        for name, picture in pictures.items():
            fresh.with_name(name).write_bytes(encode_png(picture, _note(path)))


def _materials(parts: list[Part], texture: str) -> tuple[list[str], list[str], dict[str, np.ndarray]]:
    """Name the materials of parts; return the names, the statements, and the images by file name."""
    names: list[str] = []
    texts: list[str] = []
    pictures: dict[str, np.ndarray] = {}
    for number, part in enumerate(parts, 1):
        name = str(part.material.get("name", ""))
        usable = name.isprintable() and name == name.strip() and "#" not in name and "\\" not in name
        names.append(name if name and usable and name not in names else f"material_{number}")
        begin = texture if len(parts) == 1 else f"{texture}_{number}"
        picture = None if part.picture is None else f"{begin}.png"
        if part.picture is not None:
            pictures[f"{begin}.png"] = part.picture
        text, others = statements(names[-1], part.material, np.array(part.color), picture, part.clamp, begin)
        texts.append(text)
        pictures |= {file: as_bytes(pixels) for file, pixels in others.items()}
    return names, texts, pictures


def as_bytes(pixels: np.ndarray) -> np.ndarray:
    """Convert an image [H, W, 1 or 3] with values in [0, 1], or uint8, to uint8, [H, W] if it has one channel."""
    values = pixels if pixels.dtype == np.uint8 else (pixels.clip(0, 1) * 255 + 0.5).astype(np.uint8)
    return values[..., 0] if values.shape[2] < 3 else np.ascontiguousarray(values[..., :3])


def _lines(form: str, rows: np.ndarray) -> str:
    return (form * len(rows)) % tuple(rows.reshape(-1).tolist())


def _note(path: Path) -> str:
    return f"written by neural_renderer with {path.name}"


def check_own(path: Path, files: Iterable[Path] | None, advice: str) -> None:
    """Raise FileExistsError, ending in ``advice``, if a file exists that was not written with the OBJ at ``path``.

    None stands for all MTL and PNG files that `save_mesh` or `UVMesh.save` could write.
    """
    if files is None:
        names = (f"{glob.escape(path.stem)}_texture{number}.png" for number in ("", "_*"))
        files = [path.with_suffix(".mtl"), *(file for name in names for file in path.parent.glob(name))]
    for file in files:
        if file.exists() and not _is_own(path, file):
            raise FileExistsError(
                f"{file}: expected no file, or one that was written with {path.name}, got a foreign file; {advice}"
            )


def _is_own(path: Path, file: Path) -> bool:
    """Test whether an MTL or PNG was written with the OBJ at ``path``, by this package or the first ones."""
    if not file.is_file():
        return False
    library = path.with_suffix(".mtl")
    text = library.read_text(encoding="utf-8", errors="replace") if library.is_file() else ""
    if text == f"newmtl material_1\nmap_Kd {path.stem}.png\n":  # the first packages write no note
        return file in (library, path.with_suffix(".png"))
    if file == library:
        return text.startswith(f"# {_note(path)}\n")
    try:
        with open_picture(file) as picture:
            return picture.info.get("Comment") == _note(path)
    except Exception:  # Pillow raises errors of many classes for damaged files
        return False
