"""Meshes in any common format: OBJ by our own reader and writer, the others through trimesh."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from .atlas import build_atlas, coordinates
from .cubes import check_size
from .files import existing, mesh_to_write
from .obj import obj_skin, save_obj
from .parse import read_obj
from .surface_colors import Skin
from .textured_writer import with_picture

if TYPE_CHECKING:
    import trimesh

_READABLE = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf")
_WRITABLE = (".obj", ".ply", ".glb")


def load_mesh(path: str | os.PathLike[str], texture_size: int = 4) -> tuple[Tensor, Tensor, Tensor | None]:
    """Read a mesh as it is in the file, its format told by the suffix: OBJ, PLY, STL, OFF, GLB or glTF.

    Vertices and faces keep the file's order, but STL, which repeats a vertex for every face, has equal ones joined.
    The parts of a glTF scene are put in place and together. Nothing is normalised.

    Args:
        path: The file.
        texture_size: T, texels along a cube's edge, at least 1 (the colour at the face's centre).

    Returns:
        On the CPU: vertices, float32 [V, 3]; faces, int32 [F, 3]; textures, float32 [F, T, T, T, 3] in [0, 1], or None
        if the file has no colour. Images seen through texture coordinates, colours of vertices and of faces are
        baked into the textures; glTF's linear colours become sRGB ones, as images are, and parts without any white.
        What an OBJ file names but is missing is grey 0.5, with a warning.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: Another suffix, a file that cannot be read, NaN or infinite vertices, no faces, an index out of
            range, or textures of more than 8 GiB. The file is named.
    """
    points, corners, skin, pixel_centres = read_mesh(path)
    check_size(len(corners), texture_size)
    geometry = torch.from_numpy(points.astype(np.float32)), torch.from_numpy(corners.astype(np.int32))
    if skin is None:
        return *geometry, None
    return *geometry, torch.from_numpy(skin.bake(texture_size, pixel_centres=pixel_centres))


def read_mesh(path: str | os.PathLike[str]) -> tuple[np.ndarray, np.ndarray, Skin | None, bool]:
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
        return obj.vertices, obj.faces, obj_skin(obj), False
    return *_read_others(path, suffix), True


def _read_others(path: Path, suffix: str) -> tuple[np.ndarray, np.ndarray, Skin | None]:
    import trimesh  # here, since importing it takes longer than most calls to this package

    try:
        loaded = trimesh.load(path, process=False, maintain_order=True)
        parts = list(_parts(loaded))
    except Exception as error:  # whatever a broken file makes trimesh stumble over, MemoryError included
        raise ValueError(f"{path}: cannot be read as {suffix[1:].upper()} ({error})") from error
    count = sum(len(part.faces) for part, _ in parts)
    if not count:
        known = sum(len(part.vertices) for part, _ in parts) or len(getattr(loaded, "vertices", ()))
        raise ValueError(f"{path}: expected faces, got {known} vertices but no faces")
    vertices, faces, skins = [], [], []
    offset = 0
    for part, matrix in parts:
        corners = np.asarray(part.faces, dtype=np.int64)
        points = np.asarray(part.vertices, dtype=np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
        if not np.isfinite(points).all():
            raise ValueError(f"{path}: expected finite vertices, got {int((~np.isfinite(points)).sum())} bad numbers")
        if len(corners) and (corners.min() < 0 or corners.max() >= len(points)):
            raise ValueError(f"{path}: expected face indices in [0, {len(points)}), got {corners.max()}")
        order = [0, 2, 1] if np.linalg.det(matrix[:3, :3]) < 0 else [0, 1, 2]  # a mirrored part is turned inside out
        vertices.append(points)
        faces.append(corners[:, order] + offset)
        skins.append(_part_skin(part, corners, order, linear=suffix in (".glb", ".gltf")))
        offset += len(points)
    points, corners = np.concatenate(vertices), np.concatenate(faces)
    if suffix == ".stl":
        points, corners = _join_equal(points, corners)
    if all(skin is None for skin in skins):
        return points, corners, None
    return points, corners, Skin.joined([skin or Skin.plain(len(f), 1) for skin, f in zip(skins, faces, strict=True)])


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


def _part_skin(part: Any, corners: np.ndarray, order: list[int], linear: bool) -> Skin | None:
    """The colours of one part, its corners taken in ``order``, or None; ``linear``: its plain colours are not sRGB."""
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
        pixels = np.asarray(image.convert("RGB"), dtype=np.float32) / 255
        if (factor < 1).any():
            pixels = _srgb(_unsrgb(pixels) * factor, True).astype(np.float32)
        skin.paint(np.arange(len(corners)), pixels, np.nan_to_num(visual.uv)[corners][:, order])
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


def save_mesh(path: str | os.PathLike[str], vertices: Any, faces: Any, textures: Any = None) -> None:
    """Write a mesh, its format told by the suffix; missing folders are made.

    OBJ is `save_obj`. PLY (binary) keeps vertices and faces and has one colour a vertex: the mean, over the faces
    around it, of the texture at that corner. GLB shows the textures as they are, as one picture, matt and two-sided;
    it has three vertices of its own for each face, because texture coordinates belong to vertices there.

    Args:
        path: Ends in ``.obj``, ``.ply`` or ``.glb``.
        vertices: [V, 3] float tensor or array, on any device.
        faces: [F, 3] int32 or int64.
        textures: [F, T, T, T, 3] in [0, 1] (clamped), or None.

    Raises:
        TypeError, ValueError: As told for each argument, and for another suffix.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in _WRITABLE:
        raise ValueError(f"path: expected a name that ends in {', '.join(_WRITABLE)}, got {path.name!r}")
    if suffix == ".obj":
        return save_obj(path, vertices, faces, textures)
    import trimesh

    points, corners, cubes = mesh_to_write(vertices, faces, textures)
    if cubes is None:
        mesh = trimesh.Trimesh(points, corners, process=False)
    elif suffix == ".ply":
        colours = _vertex_colours(len(points), corners, cubes)
        mesh = trimesh.Trimesh(points, corners, vertex_colors=colours, process=False)
    else:
        mesh = _with_atlas(points, corners, cubes)
    path.parent.mkdir(parents=True, exist_ok=True)
    mesh.export(path, file_type=suffix[1:])
    return None


def _vertex_colours(count: int, corners: np.ndarray, cubes: np.ndarray) -> np.ndarray:
    last = cubes.shape[1] - 1
    at_corners = np.stack([cubes[:, last, 0, 0], cubes[:, 0, last, 0], cubes[:, 0, 0, last]], axis=1)
    total, faces = np.zeros((count, 3)), np.zeros((count, 1))
    np.add.at(total, corners.reshape(-1), at_corners.reshape(-1, 3))
    np.add.at(faces, corners.reshape(-1), 1)
    colours = np.where(faces > 0, total / faces.clip(1), 0.5)
    return (np.concatenate([colours, np.ones((count, 1))], axis=1) * 255 + 0.5).astype(np.uint8)


def _with_atlas(points: np.ndarray, corners: np.ndarray, cubes: np.ndarray) -> trimesh.Trimesh:
    picture, pixels = build_atlas(cubes)
    uv = coordinates(pixels.reshape(-1, 2), picture)
    own = np.arange(corners.size).reshape(-1, 3)
    return with_picture(points[corners].reshape(-1, 3), own, uv, Image.fromarray(picture))
