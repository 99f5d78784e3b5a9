"""Meshes read from any common format: OBJ by our own reader, the others through trimesh."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote

import numpy as np
import torch
from torch import Tensor

from .cubes import check_size
from .files import existing, fits_float32, read_bytes, reason, short, warn
from .images import unpack
from .named_files import find_file
from .obj import obj_skin
from .parse import read_obj
from .surface_colors import Skin

if TYPE_CHECKING:
    import trimesh

# trimesh logs the traceback of an image that is missing, and tells of it here: what nobody asks for is not printed.
logging.getLogger("trimesh").addHandler(logging.NullHandler())

_READABLE = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf")


def load_mesh(
    path: str | os.PathLike[str], texture_size: int = 4, allow_outside: bool = False
) -> tuple[Tensor, Tensor, Tensor | None]:
    """Read a mesh as it is in the file, its format told by the suffix: OBJ, PLY, STL, OFF, GLB or glTF.

    Vertices and faces keep the file's order, but STL, which repeats a vertex for every face, has equal ones joined.
    The parts of a glTF scene are put in place and together. Nothing is normalised.

    Args:
        path: The file.
        texture_size: T, texels along a cube's edge, at least 1 (the colour at the face's centre).
        allow_outside: Read materials, images and buffers outside the file's folder too, if it names such; for files of
            people whom you trust.

    Returns:
        On the CPU: vertices, float32 [V, 3]; faces, int32 [F, 3]; textures, float32 [F, T, T, T, 3] in [0, 1], or None
        if the file has no colour. Images seen through texture coordinates, colours of vertices and of faces are
        baked into the textures; glTF's linear colours become sRGB ones, as images are, and parts without any white.
        What an OBJ file names but is missing is grey 0.5, an image that another file names white, with a warning.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: Another suffix, a file that cannot be read, vertices that are NaN, infinite or beyond float32, no
            faces, an index out of range, textures of more than 8 GiB, an image that is none or too large (see
            `load_image`), or names of files outside the folder by ``..`` without ``allow_outside``. The file is named.
    """
    points, corners, skin, pixel_centres = read_mesh(path, allow_outside)
    check_size(len(corners), texture_size)
    geometry = torch.from_numpy(points.astype(np.float32)), torch.from_numpy(corners.astype(np.int32))
    if skin is None:
        return *geometry, None
    return *geometry, torch.from_numpy(skin.bake(texture_size, pixel_centres=pixel_centres))


def read_mesh(
    path: str | os.PathLike[str], allow_outside: bool = False
) -> tuple[np.ndarray, np.ndarray, Skin | None, bool]:
    """Vertices [V, 3] float64, faces [F, 3] int64, colours if there are any; and whether u = 0 and 1 are the borders of
    an image, or the centres of its outermost pixels, as neural_renderer always read OBJ files.

    Raises what `load_mesh` raises.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in _READABLE:
        raise ValueError(f"path: expected a file that ends in {', '.join(_READABLE)}, got {path.name!r}")
    existing(path)
    if suffix == ".obj":
        obj = read_obj(path, with_uv=True)
        return obj.vertices, obj.faces, obj_skin(obj, allow_outside=allow_outside), False
    return *_read_others(path, suffix, allow_outside), True


def _read_others(path: Path, suffix: str, allow_outside: bool) -> tuple[np.ndarray, np.ndarray, Skin | None]:
    import trimesh  # here, since importing it takes longer than most calls to this package

    if suffix == ".glb":
        _check_chunks(path)
    with _NamedFiles(path, allow_outside) as named, _reading(path, suffix):
        loaded = trimesh.load(path, process=False, maintain_order=True, resolver=named)  # type: ignore[arg-type]
        parts = list(_parts(loaded))
    count = sum(len(part.faces) for part, _ in parts)
    if not count:
        known = sum(len(part.vertices) for part, _ in parts) or len(getattr(loaded, "vertices", ()))
        raise ValueError(f"{path}: expected faces, got {known} vertices but no faces")
    vertices, faces, skins = [], [], []
    known_pixels: dict[tuple[float, ...], np.ndarray] = {}
    offset = 0
    for part, matrix in parts:
        corners = np.asarray(part.faces, dtype=np.int64)
        with np.errstate(over="ignore", invalid="ignore"):
            points = np.asarray(part.vertices, dtype=np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
        good = fits_float32(points)
        if not good.all():
            raise ValueError(
                f"{path}: expected finite vertices that float32 can hold, got {int((~good).sum())} bad numbers"
            )
        if len(corners) and (corners.min() < 0 or corners.max() >= len(points)):
            raise ValueError(f"{path}: expected face indices in [0, {len(points)}), got {corners.max()}")
        order = [0, 2, 1] if np.linalg.det(matrix[:3, :3]) < 0 else [0, 1, 2]  # a mirrored part is turned inside out
        vertices.append(points)
        faces.append(corners[:, order] + offset)
        with _reading(path, suffix):
            skins.append(_part_skin(part, corners, order, suffix in (".glb", ".gltf"), known_pixels))
        offset += len(points)
    points, corners = np.concatenate(vertices), np.concatenate(faces)
    if suffix == ".stl":
        points, corners = _join_equal(points, corners)
    if all(skin is None for skin in skins):
        return points, corners, None
    return points, corners, Skin.joined([skin or Skin.plain(len(f), 1) for skin, f in zip(skins, faces, strict=True)])


def _check_chunks(path: Path) -> None:
    """Raise ValueError if a chunk of a GLB file ends beyond the file: trimesh would ask for so much memory first."""
    size = path.stat().st_size
    place = 12  # after the file's header
    with path.open("rb") as file:
        while place + 8 <= size:
            file.seek(place)
            length = int.from_bytes(file.read(4), "little")
            place += 8 + length
            if place > size:
                raise ValueError(f"{path}: expected chunks within its {size} bytes, got one of {length} bytes")


@contextmanager
def _reading(path: Path, suffix: str) -> Iterator[None]:
    """Whatever a broken file makes trimesh or Pillow stumble over, MemoryError included, as ValueError."""
    try:
        yield
    except Exception as error:
        # trimesh guesses encodings by a package that few have.
        why = "its text is not UTF-8" if isinstance(error, ModuleNotFoundError) else reason(error)
        raise ValueError(f"{path}: cannot be read as {suffix[1:].upper()} ({why})") from error


class _NamedFiles:
    """The files that a mesh file names, for trimesh, which is silent about images that it cannot get.

    Used as a context, it raises at the end what it has refused, and warns of what is missing.
    """

    def __init__(self, path: Path, allow_outside: bool) -> None:
        self._path, self._allow_outside = path, allow_outside
        self._refused: ValueError | None = None
        self._missing: list[str] = []

    def get(self, name: str) -> bytes:
        try:
            for spelling in dict.fromkeys((name, unquote(name))):  # glTF writes a space as %20
                found = find_file(self._path, spelling, allow_outside=self._allow_outside)
                if found is not None:
                    return read_bytes(found)
        except ValueError as error:
            self._refused = error
            raise
        self._missing.append(name)
        raise FileNotFoundError(f"its file {short(name)} is missing")

    __getitem__ = get

    def __enter__(self) -> _NamedFiles:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._refused is not None:
            raise self._refused from None
        for name in self._missing if kind is None else ():
            warn(f"{self._path}: its file {short(name)} is missing")


def _parts(loaded: Any) -> Iterator[tuple[trimesh.Trimesh, np.ndarray]]:
    """The meshes of a file and the matrix [4, 4] that puts each in place."""
    import trimesh

    if isinstance(loaded, trimesh.Scene):
        for node in loaded.graph.nodes_geometry:
            matrix, name = loaded.graph[node]
            if isinstance(loaded.geometry[name], trimesh.Trimesh):
                yield loaded.geometry[name], np.asarray(matrix)
    elif isinstance(loaded, trimesh.Trimesh):
        yield loaded, np.eye(4)


def _join_equal(points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Equal vertices made one, in the order in which they first appear."""
    _, first, inverse = np.unique(points, axis=0, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    return points[np.sort(first)], rank[inverse.reshape(-1)[corners]]


def _part_skin(
    part: Any, corners: np.ndarray, order: list[int], linear: bool, known_pixels: dict[tuple[float, ...], np.ndarray]
) -> Skin | None:
    """The colours of one part, its corners taken in ``order``, or None.

    linear: its plain colours are not sRGB. known_pixels: of the pictures that earlier parts showed.
    """
    visual = part.visual
    kind = visual.kind if visual is not None and visual.defined else None
    skin = Skin.plain(len(corners), 1.0)
    if kind == "vertex":
        skin.colors[:] = _srgb(visual.vertex_colors[:, :3] / 255, linear)[corners][:, order]
        return skin
    if kind == "face":
        skin.colors[:] = _srgb(visual.face_colors[:, :3] / 255, linear)[:, None]
        return skin
    if kind != "texture":
        return None
    material = visual.material
    image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
    factor = getattr(material, "baseColorFactor", None)
    factor = np.ones(3) if factor is None else np.asarray(factor, dtype=np.float64)[:3] / 255
    if image is not None and visual.uv is not None:
        key = (id(image), *factor)
        if key not in known_pixels:
            pixels = unpack("its image", image, transparency=False)
            if (factor < 1).any():
                pixels = _srgb(_unsrgb(pixels) * factor, True).astype(np.float32)
            known_pixels[key] = pixels
        uv = np.where(fits_float32(visual.uv), visual.uv, 0)
        skin.paint(np.arange(len(corners)), known_pixels[key], uv[corners][:, order])
        return skin
    if not linear and not hasattr(material, "baseColorFactor"):
        factor = np.asarray(material.main_color, dtype=np.float64)[:3] / 255
    skin.colors[:] = _srgb(factor, linear)
    return skin


def _srgb(colours: np.ndarray, linear: bool) -> np.ndarray:
    """Linear colours as sRGB; with ``linear=False`` they are that already."""
    if not linear:
        return colours
    return np.where(colours <= 0.0031308, colours * 12.92, 1.055 * np.maximum(colours, 1e-9) ** (1 / 2.4) - 0.055)


def _unsrgb(colours: np.ndarray) -> np.ndarray:
    return np.where(colours <= 0.04045, colours / 12.92, ((colours + 0.055) / 1.055) ** 2.4)
