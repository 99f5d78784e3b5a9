"""Meshes written as OBJ, PLY or GLB, their colours as texture cubes or as images with texture coordinates."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from .atlas import build_atlas, coordinates
from .atomic_write import write_file
from .cubes import bake_corners
from .files import mesh_to_write
from .obj_writer import Part, save_cubes, write_obj
from .surface_colors import Skin

if TYPE_CHECKING:
    import trimesh

_SUFFIXES = (".obj", ".ply", ".glb")


def save_mesh(
    path: str | os.PathLike[str], vertices: Any, faces: Any, textures: Any = None, *, overwrite: bool = False
) -> None:
    """Write a mesh, its format told by the suffix; missing folders are made.

    OBJ has its materials and its picture beside it: ``spot.obj``, ``spot.mtl``, ``spot_texture.png``. PLY (binary)
    keeps vertices and faces and has one colour a vertex: the mean, over the faces around it, of the texture at that
    corner. GLB shows the textures as they are, as one picture, matt and two-sided; it has three vertices of its own for
    each face, because texture coordinates belong to vertices there.

    Args:
        path: Ends in ``.obj``, ``.ply`` or ``.glb``. A file of that name is replaced.
        vertices: [V, 3] float tensor or array, on any device.
        faces: [F, 3], whole numbers of any real dtype.
        textures: [F, T, T, T, 3] in [0, 1] (clamped), or None.
        overwrite: Replace the files beside an OBJ whoever made them; otherwise only those that were written with an
            OBJ of this name before.

    Raises:
        TypeError, ValueError: As told for each argument, and for another suffix.
        FileExistsError: A file beside an OBJ would be replaced that was not written with it.
        OSError: The files cannot be written. All that was there before stays.
    """
    path = _checked(path, _SUFFIXES)
    if path.suffix.lower() == ".obj":
        save_cubes(path, vertices, faces, textures, f"{path.stem}_texture", overwrite)
        return
    import trimesh  # here, since importing it takes longer than most calls to this package

    points, corners, cubes = mesh_to_write(vertices, faces, textures)
    if cubes is None:
        mesh = trimesh.Trimesh(points, corners, process=False)
    elif path.suffix.lower() == ".ply":
        colours = _vertex_colours(len(points), corners, cubes)
        mesh = trimesh.Trimesh(points, corners, vertex_colors=colours, process=False)
    else:
        picture, pixels = build_atlas(cubes)
        own = np.arange(corners.size).reshape(-1, 3)
        mesh = _with_picture(points[corners].reshape(-1, 3), own, coordinates(pixels.reshape(-1, 2), picture), picture)
    write_file(path, mesh.export(file_type=path.suffix[1:].lower()))  # type: ignore[arg-type]  # bytes


def save_painted(
    path: str | os.PathLike[str], vertices: Any, faces: Any, skin: Skin, *, overwrite: bool = False
) -> None:
    """Write a mesh with images as OBJ, its materials and pictures beside it, or as GLB; see `save_mesh`.

    ``skin`` are the colours, clamped to [0, 1]. Faces without an image share one more, with a tile for each. With
    several images, those of an OBJ are ``spot_texture_1.png`` and so on. Raises what `save_mesh` raises.
    """
    path = _checked(path, (".obj", ".glb"))
    points, corners, _ = mesh_to_write(vertices, faces)
    parts = _parts(skin)
    if path.suffix.lower() == ".obj":
        write_obj(path, points, corners, parts, f"{path.stem}_texture", overwrite)
        return
    import trimesh

    scene = trimesh.Scene()
    for number, part in enumerate(parts, 1):
        # A vertex has one place on the picture there: one that has several becomes as many.
        both = np.stack([corners[part.faces], part.corners], axis=2).reshape(-1, 2)
        own, index = np.unique(both, axis=0, return_inverse=True)
        mesh = _with_picture(points[own[:, 0]], index.reshape(-1, 3), part.places[own[:, 1]], part.picture)
        scene.add_geometry(mesh, geom_name=f"part_{number}")
    write_file(path, scene.export(file_type="glb"))


def _checked(path: str | os.PathLike[str], suffixes: tuple[str, ...]) -> Path:
    path = Path(path)
    if path.suffix.lower() not in suffixes:
        raise ValueError(f"path: expected a name that ends in {', '.join(suffixes)}, got {path.name!r}")
    return path


def _parts(skin: Skin) -> list[Part]:
    found = []
    for number, (image, wrapping) in enumerate(zip(skin.images, skin.wrapping, strict=True)):
        own = np.flatnonzero(skin.image == number)
        if len(own):
            pixels = (image.clip(0, 1) * 255 + 0.5).astype(np.uint8)
            found.append(_part(own, skin.uv[own], pixels, wrapping != "REPEAT"))
    plain = np.flatnonzero(skin.image < 0)
    if len(plain):
        pixels, place = build_atlas(bake_corners(skin.colors[plain].clip(0, 1), 2))
        found.append(_part(plain, coordinates(place, pixels), pixels, True))
    return found


def _part(faces: np.ndarray, uv: np.ndarray, picture: np.ndarray, clamp: bool) -> Part:
    places, corners = np.unique(uv.reshape(-1, 2), axis=0, return_inverse=True)
    return Part(faces, places, corners.reshape(-1, 3), picture, clamp)


def _vertex_colours(count: int, corners: np.ndarray, cubes: np.ndarray) -> np.ndarray:
    last = cubes.shape[1] - 1
    at_corners = np.stack([cubes[:, last, 0, 0], cubes[:, 0, last, 0], cubes[:, 0, 0, last]], axis=1)
    total, faces = np.zeros((count, 3)), np.zeros((count, 1))
    np.add.at(total, corners.reshape(-1), at_corners.reshape(-1, 3))
    np.add.at(faces, corners.reshape(-1), 1)
    colours = np.where(faces > 0, total / faces.clip(1), 0.5)
    return (np.concatenate([colours, np.ones((count, 1))], axis=1) * 255 + 0.5).astype(np.uint8)


def _with_picture(points: np.ndarray, corners: np.ndarray, uv: np.ndarray, picture: np.ndarray) -> trimesh.Trimesh:
    """A mesh that shows a picture as it is, matt and from both sides; uv: [V, 2], where its vertices are on it."""
    import trimesh

    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=Image.fromarray(picture), metallicFactor=0.0, roughnessFactor=1.0, doubleSided=True
    )
    visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    return trimesh.Trimesh(points, corners, visual=visual, process=False)
