"""Writing of meshes with texture cubes or images, as OBJ, PLY or GLB."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from .atlas import build_atlas, coordinates
from .atomic_write import write_file
from .cubes import bake_corners
from .files import mesh_to_write, warn
from .gltf.writer import glb_bytes
from .obj.writer import Part, as_bytes, save_cubes, write_obj
from .ply.writer import ply_bytes
from .surface_colors import SurfaceColors, linear_to_srgb, srgb_to_linear

_SUFFIXES = (".obj", ".ply", ".glb")


def save_mesh(
    path: str | os.PathLike[str], vertices: Any, faces: Any, textures: Any = None, *, overwrite: bool = False
) -> None:
    """Write a mesh as OBJ, PLY or GLB. Missing folders are made.

    - OBJ: materials and image are files beside it, ``spot.mtl`` and ``spot_texture.png`` for ``spot.obj``.
    - PLY (binary): one colour per vertex, the mean of the textures of the faces around it, at that corner.
    - GLB: the textures as one image, matt and two-sided, with a tile for each face. A glTF vertex has one texture
      coordinate, so each face has three vertices of its own; `load_mesh` makes them one again. A mesh of one colour has
      no image, and shares vertices. Vertices that no face uses are left out.

    Args:
        path: Name that ends in ``.obj``, ``.ply`` or ``.glb``. A file of this name is replaced.
        vertices: [V, 3] floating tensor or array, on any device.
        faces: [F, 3] tensor or array of whole numbers.
        textures: [F, T, T, T, 3] floating, clamped to [0, 1]; or None.
        overwrite: Replace any MTL and PNG beside an OBJ. By default only those are replaced that were written with an
            OBJ of this name.

    Raises:
        TypeError, ValueError: The suffix is unknown, a type or shape does not fit, or a number is not finite.
        FileExistsError: The MTL or PNG would replace a foreign file.
        OSError: A file cannot be written. All existing files stay as they were.

    Example:
        >>> vertices, faces = nr.torus()
        >>> nr.save_mesh("torus.glb", vertices, faces, torch.ones(len(faces), 1, 1, 1, 3))
    """
    path = _checked(path, _SUFFIXES)
    if path.suffix.lower() == ".obj":
        save_cubes(path, vertices, faces, textures, f"{path.stem}_texture", overwrite)
        return
    points, corners, cubes = mesh_to_write(vertices, faces, textures)
    if path.suffix.lower() == ".ply":
        write_file(path, ply_bytes(points, corners, _vertex_colors(len(points), corners, cubes)))
        return
    surface = SurfaceColors.plain(len(corners), 1.0)  # white
    if cubes is not None and cubes.size and (cubes == cubes[0, 0, 0, 0]).all():
        surface.colors[:] = cubes[0, 0, 0, 0]
    elif cubes is not None and cubes.size:
        picture, pixels = build_atlas(cubes)
        surface.image[:], surface.uv = 0, coordinates(pixels, picture)
        surface.images, surface.wraps = [picture], ["clamp"]
    write_file(path, glb_bytes(points, corners, surface))


def as_trimesh(vertices: Any, faces: Any, textures: Any = None) -> Any:
    """Convert a mesh to a ``trimesh.Trimesh`` with a colour for each vertex; arguments and errors as `save_mesh`."""
    import trimesh  # imported here because it is slow

    points, corners, cubes = mesh_to_write(vertices, faces, textures)
    return trimesh.Trimesh(points, corners, vertex_colors=_vertex_colors(len(points), corners, cubes), process=False)


def save_uv_mesh(
    path: str | os.PathLike[str], vertices: Any, faces: Any, surface: SurfaceColors, *, overwrite: bool = False
) -> None:
    """Write a mesh with images as OBJ or GLB; see `UVMesh.save`. Colours are clamped to [0, 1]."""
    path = _checked(path, (".obj", ".glb"))
    points, corners, _ = mesh_to_write(vertices, faces)
    if path.suffix.lower() == ".glb":
        write_file(path, glb_bytes(points, corners, surface))
        return
    write_obj(path, points, corners, _parts(_without_tints(path, surface)), f"{path.stem}_texture", overwrite)


def _checked(path: str | os.PathLike[str], suffixes: tuple[str, ...]) -> Path:
    path = Path(path)
    if path.suffix.lower() not in suffixes:
        raise ValueError(f"path: expected a name that ends in {', '.join(suffixes)}, got {path.name!r}")
    return path


def _parts(surface: SurfaceColors) -> list[Part]:
    """Group faces by image and material; those without an image share one with a tile for each, or have one colour."""
    numbers = np.full(len(surface.image), -1) if surface.material is None else surface.material
    found = []
    for image, number in np.unique(np.stack((surface.image, numbers), 1), axis=0).tolist():
        faces = np.flatnonzero((surface.image == image) & (numbers == number))
        material = surface.materials[number] if number >= 0 else {}
        colors = surface.colors[faces].clip(0, 1)
        if image >= 0:
            pixels = as_bytes(surface.images[image])
            clamp = surface.wraps[image] in ("clamp", ("clamp", "clamp"))
            part = _part(faces, surface.uv[faces], pixels, clamp)
        elif material and (colors == colors[0, 0]).all():
            red, green, blue = colors[0, 0].tolist()
            part = _part(faces, surface.uv[faces], None, False)._replace(color=(red, green, blue))
        else:
            tiles, place = build_atlas(bake_corners(torch.from_numpy(colors), 2).numpy())
            part = _part(faces, coordinates(place, tiles), tiles, True)
        normals = None if surface.normals is None else surface.normals[faces]
        found.append(part._replace(material=material, normals=normals))
    # Faces with images first.
    return sorted(found, key=lambda part: surface.image[part.faces[0]] < 0)


def _without_tints(path: Path, surface: SurfaceColors) -> SurfaceColors:
    """Put the tints of faces without an image into their colours; warn about those of images, which OBJ lacks."""
    if surface.tints is None:
        return surface
    plain, tints = surface.image < 0, surface.tints[..., :3].clip(0, 1)
    if (tints[~plain] != 1).any():
        warn(f"{path}: OBJ has no colours of vertices over images, so they are left out; GLB keeps them")
    linear = srgb_to_linear(surface.colors.astype(np.float64).clip(0, 1))
    colors = np.where(plain[:, None, None], linear_to_srgb(linear * tints), surface.colors)
    return replace(surface, colors=colors.astype(np.float32), tints=None)


def _part(faces: np.ndarray, uv: np.ndarray, picture: np.ndarray | None, clamp: bool) -> Part:
    """Make a part of faces [n] with texture coordinates [n, 3, 2]; equal coordinates are merged."""
    places, corners = np.unique(uv.reshape(-1, 2), axis=0, return_inverse=True)
    return Part(faces, places, corners.reshape(-1, 3), picture, clamp)


def _vertex_colors(count: int, corners: np.ndarray, cubes: np.ndarray | None) -> np.ndarray | None:
    """Average the cubes of the faces around each vertex, at that corner: [V, 4] uint8. Unused vertices are grey.

    None without cubes.
    """
    if cubes is None or not cubes.size:
        return None
    last = cubes.shape[1] - 1
    at_corners = np.stack([cubes[:, last, 0, 0], cubes[:, 0, last, 0], cubes[:, 0, 0, last]], axis=1)
    total, faces = np.zeros((count, 3)), np.zeros((count, 1))
    np.add.at(total, corners.reshape(-1), at_corners.reshape(-1, 3))
    np.add.at(faces, corners.reshape(-1), 1)
    colors = np.where(faces > 0, total / faces.clip(1), 0.5)
    rounded: np.ndarray = (np.concatenate([colors, np.ones((count, 1))], axis=1) * 255 + 0.5).astype(np.uint8)
    return rounded
