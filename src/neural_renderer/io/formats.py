"""Reading of meshes: OBJ by `parse`, other formats through trimesh."""

from __future__ import annotations

import io
import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from .cubes import check_size
from .files import existing, fits_float32, read_bytes, reason, short, warn
from .gltf.container import KEPT, prepared
from .gltf.materials import GltfMaterial
from .images import unpack
from .named_files import find_file
from .obj import obj_surface_colors
from .obj.parse import read_obj
from .surface_colors import SurfaceColors

if TYPE_CHECKING:
    import trimesh

# trimesh logs a traceback for each missing image. This package warns instead, so the log is not printed by default.
logging.getLogger("trimesh").addHandler(logging.NullHandler())

_READABLE = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf")
_GLB_HEADER = 12  # bytes
_CHUNK_HEADER = 8  # bytes: length and type


def load_mesh(
    path: str | os.PathLike[str], texture_size: int = 4, allow_outside: bool = False
) -> tuple[Tensor, Tensor, Tensor | None]:
    """Read a mesh file and bake its colours into texture cubes. The mesh is not normalised.

    Vertices and faces keep the file's order. STL files repeat each vertex for every face; equal vertices are merged.
    The parts of a glTF scene are transformed and joined.

    Args:
        path: File that ends in .obj, .ply, .stl, .off, .glb or .gltf.
        texture_size: T, texels along a cube's edge, ≥ 1. With 1 each face has the colour of its centre.
        allow_outside: Read materials, images and buffers outside the file's folder, too. Use it for trusted files only.

    Returns:
        Vertices [V, 3] float32, faces [F, 3] int32, and textures [F, T, T, T, 3] float32 in [0, 1], or None if the file
        has no colours; all on the CPU. Images, vertex colours and face colours are baked; linear colours of glTF are
        converted to sRGB. Parts without colours are white.

    Raises:
        FileNotFoundError: The file does not exist.
        ValueError: The suffix is unknown, the file is damaged, a vertex is not finite in float32, there are no faces,
            an index is out of range, the textures exceed 8 GiB, an image is damaged or too large (see `load_image`), or
            the file names files outside its folder by ``..`` without ``allow_outside``.

    Warns:
        UserWarning: An image or material is missing. OBJ files get grey 0.5 in its place, others white.

    Example:
        >>> nr.save_mesh("sphere.ply", *nr.icosphere(2))
        >>> vertices, faces, textures = nr.load_mesh("sphere.ply")
        >>> vertices.shape, faces.shape, textures
        (torch.Size([162, 3]), torch.Size([320, 3]), None)
    """
    points, corners, surface, pixel_centers = read_mesh(path, allow_outside)
    check_size(len(corners), texture_size)
    geometry = torch.from_numpy(points.astype(np.float32)), torch.from_numpy(corners.astype(np.int32))
    if surface is None:
        return *geometry, None
    return *geometry, torch.from_numpy(surface.bake(texture_size, pixel_centers=pixel_centers))


def read_mesh(
    path: str | os.PathLike[str], allow_outside: bool = False, materials: bool = False
) -> tuple[np.ndarray, np.ndarray, SurfaceColors | None, bool]:
    """Read a mesh file without baking; arguments and errors as `load_mesh`.

    Args:
        path, allow_outside: As in `load_mesh`.
        materials: Read materials, normals and second texture coordinates, too.

    Returns:
        Vertices [V, 3] float64, faces [F, 3] int64, surface colours or None, and ``pixel_centers`` of `bake_image`.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in _READABLE:
        raise ValueError(f"path: expected a file that ends in {', '.join(_READABLE)}, got {path.name!r}")
    existing(path)
    if suffix == ".obj":
        obj = read_obj(path, with_uv=True)
        surface = obj_surface_colors(obj, allow_outside=allow_outside, with_materials=materials)
        return obj.vertices, obj.faces, surface, False
    return *_read_others(path, suffix, allow_outside, materials), True


def _read_others(
    path: Path, suffix: str, allow_outside: bool, materials: bool
) -> tuple[np.ndarray, np.ndarray, SurfaceColors | None]:
    """Read a mesh file through trimesh: vertices, faces and surface colours or None."""
    import trimesh  # imported here because it is slow

    if suffix == ".glb":
        _check_chunks(path)
    source: Any = path
    parser = _PartReader({}, materials)
    with _NamedFiles(path, allow_outside) as named, _reading(path, suffix):
        if suffix in (".glb", ".gltf"):
            data, parser.tree = prepared(read_bytes(path), suffix == ".glb")
            source = io.BytesIO(data)
        options: dict[str, Any] = {"process": False, "maintain_order": True, "resolver": named}
        loaded = trimesh.load(source, file_type=suffix[1:], **options)
        parts = list(_parts(loaded))
    count = sum(len(part.faces) for part, _ in parts)
    if not count:
        known = sum(len(part.vertices) for part, _ in parts) or len(getattr(loaded, "vertices", ()))
        raise ValueError(f"{path}: expected faces, got {known} vertices but no faces")
    vertices, faces, surfaces = [], [], []
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
        order = [0, 2, 1] if np.linalg.det(matrix[:3, :3]) < 0 else [0, 1, 2]  # mirroring turns faces inside out
        vertices.append(points)
        faces.append(corners[:, order] + offset)
        with _reading(path, suffix):
            surfaces.append(parser.surface_colors(part, corners, order, matrix[:3, :3]))
        offset += len(points)
    points, corners = np.concatenate(vertices), np.concatenate(faces)
    if suffix == ".stl":
        points, corners = _join_equal(points, corners)
    if all(surface is None for surface in surfaces):
        return points, corners, None
    known_surfaces = [known or SurfaceColors.plain(len(f), 1) for known, f in zip(surfaces, faces, strict=True)]
    return points, corners, SurfaceColors.joined(known_surfaces)


def _check_chunks(path: Path) -> None:
    """Raise ValueError if a chunk of a GLB file ends beyond the file. trimesh would allocate that much memory."""
    size = path.stat().st_size
    place = _GLB_HEADER
    with path.open("rb") as file:
        while place + _CHUNK_HEADER <= size:
            file.seek(place)
            length = int.from_bytes(file.read(4), "little")
            place += _CHUNK_HEADER + length
            if place > size:
                raise ValueError(f"{path}: expected chunks within its {size} bytes, got one of {length} bytes")


@contextmanager
def _reading(path: Path, suffix: str) -> Iterator[None]:
    """Convert all errors of trimesh and Pillow on damaged files, such as MemoryError, to ValueError."""
    try:
        yield
    except Exception as error:
        # For text that is not UTF-8, trimesh imports an optional package that detects encodings.
        why = "its text is not UTF-8" if isinstance(error, ModuleNotFoundError) else reason(error)
        raise ValueError(f"{path}: cannot be read as {suffix[1:].upper()} ({why})") from error


class _NamedFiles:
    """Resolver of file names for trimesh, which does not report images that it cannot open.

    It is a context: at its end it raises an error for a refused file and warns about missing ones.
    """

    def __init__(self, path: Path, allow_outside: bool) -> None:
        self._path, self._allow_outside = path, allow_outside
        self._refused: ValueError | None = None
        self._missing: list[str] = []

    def get(self, name: str) -> bytes:
        """Read the file called ``name``; raise ValueError if it is refused, FileNotFoundError if it is missing."""
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
    """Iterate over the meshes of a file and their transforms [4, 4]."""
    import trimesh

    if isinstance(loaded, trimesh.Scene):
        for node in loaded.graph.nodes_geometry:
            matrix, name = loaded.graph[node]
            if isinstance(loaded.geometry[name], trimesh.Trimesh):
                yield loaded.geometry[name], np.asarray(matrix)
    elif isinstance(loaded, trimesh.Trimesh):
        yield loaded, np.eye(4)


def _join_equal(points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Merge equal vertices; keep the order of first appearance."""
    _, first, inverse = np.unique(points, axis=0, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.int64)
    rank[np.argsort(first)] = np.arange(len(first))
    return points[np.sort(first)], rank[inverse.reshape(-1)[corners]]


class _PartReader:
    """Reader of the surface colours and materials of the parts of a file.

    Args:
        tree: JSON of a glTF file; empty for other formats.
        materials: Whether to read materials, normals and second texture coordinates.
    """

    def __init__(self, tree: dict[str, Any], materials: bool) -> None:
        self.tree, self._with_materials = tree, materials
        self._pixels: dict[tuple[float, ...], np.ndarray] = {}  # by image, channels and colour factor
        self._materials: dict[int, dict[str, Any]] = {}

    def surface_colors(
        self, part: Any, corners: np.ndarray, order: list[int], matrix: np.ndarray
    ) -> SurfaceColors | None:
        """Collect the colours of one part, or None if it has none.

        Args:
            part: Mesh of trimesh.
            corners: [F, 3] int64, its faces.
            order: Order of the corners in the result.
            matrix: [3, 3], linear part of its transform.
        """
        surface = SurfaceColors.plain(len(corners), 1.0)
        own = corners[:, order]
        material = self._paint(surface, part, own)
        if self._with_materials and self.tree:
            self._add_directions(surface, part, own, matrix)
            surface.has_colors = material is not None
            if isinstance(material, GltfMaterial):
                self._add_material(surface, part, own, material)
            return surface
        return None if material is None else surface

    def _paint(self, surface: SurfaceColors, part: Any, corners: np.ndarray) -> GltfMaterial | bool | None:
        """Set colours and images. Returns the part's material if it has one, else whether it has colours, or None."""
        visual, linear = part.visual, bool(self.tree)
        kind = visual.kind if visual is not None and visual.defined else None
        if kind == "vertex":
            surface.colors[:] = _srgb(visual.vertex_colors[:, :3] / 255, linear)[corners]
            return True
        if kind == "face":
            surface.colors[:] = _srgb(visual.face_colors[:, :3] / 255, linear)[:, None]
            return True
        if kind != "texture":
            return None
        material, slot = visual.material, None
        name = str(getattr(material, "name", ""))
        if self.tree and name.isdigit():
            slot = GltfMaterial(self.tree, int(name))
        image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
        factor = getattr(material, "baseColorFactor", None)
        factor = np.ones(3) if factor is None else np.asarray(factor, dtype=np.float64)[:3] / 255
        if slot is not None:
            factor = np.array(slot.factor[:3])
        uv = visual.uv if slot is None or slot.base.uv_set == 0 else _upwards(_attribute(part, "TEXCOORD_1", 2))
        if uv is not None:
            uv = uv if slot is None else slot.base.transformed(np.asarray(uv, dtype=np.float64))
            surface.uv[:] = np.where(fits_float32(uv), uv, 0)[corners]
        if image is not None and uv is not None:
            wrapping = "REPEAT" if slot is None else _wrapping(slot.base.wrap)
            surface.paint(np.arange(len(corners)), self._image(image, 3, factor), surface.uv.copy(), wrapping)
            return slot or True
        if not linear and not hasattr(material, "baseColorFactor"):
            factor = np.asarray(material.main_color, dtype=np.float64)[:3] / 255
        surface.colors[:] = _srgb(factor, linear)
        shades = getattr(visual, "vertex_attributes", {}).get("color")
        if linear and isinstance(shades, np.ndarray) and shades.ndim == 2 and shades.shape[1] in (3, 4):
            full = np.iinfo(shades.dtype).max if shades.dtype.kind in "iu" else 1.0
            shades = np.nan_to_num(shades[:, :3].astype(np.float64) / full).clip(0, 1)
            surface.colors[:] = _srgb(shades * factor, linear)[corners]
        return slot or True

    def _image(self, image: Any, channels: int, factor: np.ndarray | None = None) -> np.ndarray:
        """Decode an image to [H, W, channels] float32, in linear light times a factor: RGB, or alpha alone."""
        factor = np.ones(3) if factor is None else factor
        key = (id(image), channels, *factor)
        if key not in self._pixels:
            pixels = unpack("its image", image, transparency=channels == 1)
            if channels == 1:
                pixels = pixels[..., 3:] if pixels.shape[2] == 4 else np.ones_like(pixels[..., :1])
            elif (factor < 1).any():
                pixels = _srgb(_unsrgb(pixels) * factor, True).astype(np.float32)
            self._pixels[key] = pixels
        return self._pixels[key]

    def _add_material(self, surface: SurfaceColors, part: Any, corners: np.ndarray, material: GltfMaterial) -> None:
        """Set the material of a part, and the texture coordinates that it needs."""

        def image(name: str, channels: int) -> np.ndarray | None:
            found = getattr(part.visual.material, name, None)
            return self._image(found, channels) if isinstance(found, Image.Image) else None

        if material.number not in self._materials:
            self._materials[material.number] = material.arguments(image)
        surface.materials = [self._materials[material.number]]
        surface.material = np.zeros(len(corners), np.int64)
        raw = material.raw_set()
        if raw is not None:
            uv = _upwards(_attribute(part, f"TEXCOORD_{raw}", 2))
            surface.uv1 = np.zeros((len(corners), 3, 2)) if uv is None else uv[corners]

    @staticmethod
    def _add_directions(surface: SurfaceColors, part: Any, corners: np.ndarray, matrix: np.ndarray) -> None:
        """Set normals and tangents, turned as the part is. Those without a direction become 0."""
        determinant = np.linalg.det(matrix)
        normals, tangents = _attribute(part, "NORMAL", 3), _attribute(part, "TANGENT", 4)
        if normals is not None and determinant:
            surface.normals = _unit(normals @ np.linalg.inv(matrix))[corners]
        if tangents is not None:
            sign = np.where(tangents[:, 3:] < 0, -1.0, 1.0) * np.sign(determinant)
            surface.tangents = np.concatenate((_unit(tangents[:, :3] @ matrix.T), sign), -1)[corners]


def _attribute(part: Any, name: str, width: int) -> np.ndarray | None:
    """Return a vertex attribute of a part, [V, width] float64, as the file has it; None without usable values."""
    values = (part.vertex_attributes or {}).get(KEPT[name])
    if not isinstance(values, np.ndarray) or values.shape != (len(part.vertices), width):
        return None
    if values.dtype.kind in "iu":  # normalised
        values = np.maximum(values / np.iinfo(values.dtype).max, -1.0)
    values = values.astype(np.float64)
    return np.where(fits_float32(values), values, 0)


def _upwards(uv: np.ndarray | None) -> np.ndarray | None:
    """Turn texture coordinates [V, 2] from v down to v up."""
    return None if uv is None else np.stack((uv[:, 0], 1 - uv[:, 1]), -1)


def _unit(directions: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore", invalid="ignore"):
        length = np.linalg.norm(directions, axis=-1, keepdims=True)
        unit = directions / np.where(length > 0, length, 1)
    return np.where(np.isfinite(unit), unit, 0)


_WRAPPINGS = {"repeat": "REPEAT", "clamp": "CLAMP_TO_EDGE", "mirror": "MIRRORED_REPEAT"}


def _wrapping(wrap: tuple[str, str]) -> str | tuple[str, str]:
    """Convert the modes of u and v to those of `SurfaceColors`, one if they are equal."""
    u, v = (_WRAPPINGS[mode] for mode in wrap)
    return u if u == v else (u, v)


def _srgb(colors: np.ndarray, linear: bool) -> np.ndarray:
    """Convert linear colours to sRGB; return others unchanged."""
    if not linear:
        return colors
    return np.where(colors <= 0.0031308, colors * 12.92, 1.055 * np.maximum(colors, 1e-9) ** (1 / 2.4) - 0.055)


def _unsrgb(colors: np.ndarray) -> np.ndarray:
    """Convert sRGB colours to linear ones."""
    return np.where(colors <= 0.04045, colors / 12.92, ((colors + 0.055) / 1.055) ** 2.4)
