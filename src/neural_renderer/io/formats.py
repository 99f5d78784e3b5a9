"""Reading of meshes of all formats."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import torch
from torch import Tensor

from .cubes import check_size
from .files import existing, read_bytes, reason, short, warn
from .gltf.reader import GltfReader
from .gltf.rig_reader import RigFile
from .gltf.tree import GltfError
from .named_files import Listings, find_file
from .obj import obj_surface_colors
from .obj.parse import read_obj
from .off import read_off
from .ply import read_ply
from .stl import read_stl
from .surface_colors import SurfaceColors

MESH_SUFFIXES = (".obj", ".ply", ".stl", ".off", ".glb", ".gltf")
"""Suffixes of mesh files that can be read."""
_GLTF = (".glb", ".gltf")


def load_mesh(
    path: str | os.PathLike[str], texture_size: int = 4, allow_outside: bool = False
) -> tuple[Tensor, Tensor, Tensor | None]:
    """Read a mesh file and bake its colours into texture cubes. The mesh is not normalised.

    Vertices and faces keep the file's order. STL files repeat each vertex for every face; equal vertices are merged.
    The parts of a glTF scene are transformed and joined. glTF duplicates a vertex at the seams of textures and normals;
    in files of this package it is one again, in others `Mesh.merge_vertices` mends the seams.

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
    geometry = (
        torch.from_numpy(points.astype(np.float32, copy=False)),
        torch.from_numpy(corners.astype(np.int32, copy=False)),
    )
    if surface is None or not surface.has_colors:
        return *geometry, None
    return *geometry, torch.from_numpy(surface.bake(texture_size, pixel_centers=pixel_centers))


def read_mesh(
    path: str | os.PathLike[str], allow_outside: bool = False, materials: bool = False
) -> tuple[np.ndarray, np.ndarray, SurfaceColors | None, bool]:
    """Read a mesh file without baking, as `load_mesh`; with ``materials``, also materials, normals and uv1.

    Returns vertices [V, 3] floating, faces [F, 3] integer, surface colours or None, and ``pixel_centers`` of
    `bake_image`. Surface colours without ``has_colors`` have only the other attributes of the file.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in MESH_SUFFIXES:
        raise ValueError(f"path: expected a file that ends in {', '.join(MESH_SUFFIXES)}, got {path.name!r}")
    existing(path)
    if suffix == ".obj":
        obj = read_obj(path, with_uv=True)
        surface = obj_surface_colors(obj, allow_outside=allow_outside, with_materials=materials)
        return obj.vertices, obj.faces, surface, False
    if suffix == ".ply":
        return *read_ply(path, allow_outside), True
    if suffix == ".stl":
        return *read_stl(path), None, True
    if suffix == ".off":
        return *read_off(path), True
    return *_read_gltf(path, allow_outside, materials)[:3], True


def read_rigged(
    path: str | os.PathLike[str], allow_outside: bool = False
) -> tuple[np.ndarray, np.ndarray, Any, RigFile]:
    """Read a glTF or GLB file with its nodes, skins, morph targets and animations; ValueError if they are damaged.

    Returns vertices [V, 3] float64 and faces [F, 3] int64, in the order of `read_mesh`; colours, materials and normals;
    and the rig. Vertices and normals are those of the meshes, before nodes or joints transform them.
    """
    path = Path(path)
    if path.suffix.lower() not in _GLTF:
        raise ValueError(f"path: expected a file that ends in .glb or .gltf, got {path.name!r}")
    *mesh, rig = _read_gltf(existing(path), allow_outside, True, rigged=True)
    return *mesh, rig  # type: ignore[return-value]


def _read_gltf(
    path: Path, allow_outside: bool, materials: bool, rigged: bool = False
) -> tuple[np.ndarray, np.ndarray, SurfaceColors, RigFile | None]:
    """Read a glTF or GLB file, and warn about what is left out of it; ValueError names the file."""
    refused: list[ValueError] = []
    missing: list[str] = []
    contents: dict[Path, bytes] = {}  # a file may be named many times
    listings: Listings = {}

    def resolve(name: str) -> bytes:
        """Read the file called ``name``; raise ValueError if it is refused, FileNotFoundError if it is missing."""
        try:
            spellings = dict.fromkeys((name, unquote(name)))  # glTF writes a space as %20
            found = (find_file(path, one, allow_outside=allow_outside, listings=listings) for one in spellings)
            place = next((one for one in found if one is not None), None)
        except ValueError as error:
            refused.append(error)
            raise
        if place is None:
            missing.append(f"its file {short(name)} is missing")
            raise FileNotFoundError(missing[-1])
        if place not in contents:
            contents[place] = read_bytes(place)
        return contents[place]

    try:
        reader = GltfReader(read_bytes(path), resolve)
        found = reader.read(materials, rigged)
    except Exception as error:  # of other classes where the JSON has values of a kind that is not expected
        if refused:
            raise refused[0] from None
        known = isinstance(error, (GltfError, FileNotFoundError, ModuleNotFoundError))
        why = reason(error) if known else "its content does not follow the specification of glTF"
        why = "it asks for more memory than there is" if isinstance(error, MemoryError) else why
        raise ValueError(f"{path}: cannot be read as {path.suffix[1:].upper()} ({why})") from error
    for sentence in (*missing, *reader.warnings):
        warn(f"{path}: {sentence}")
    return found
