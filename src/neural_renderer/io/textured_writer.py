"""Meshes with images as their colour, written as OBJ or GLB with the texture coordinates they have."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from PIL import Image

from .atlas import build_atlas, coordinates
from .cubes import bake_corners
from .files import mesh_to_write
from .obj import format_lines, format_material
from .surface_colors import Skin

if TYPE_CHECKING:
    import trimesh


class _Part(NamedTuple):
    """The faces [n] that show one picture, where their corners are on it [n, 3, 2], and the picture, H × W × RGB."""

    faces: np.ndarray
    uv: np.ndarray
    picture: Image.Image
    clamp: bool


def save_painted(path: str | os.PathLike[str], vertices: Any, faces: Any, skin: Skin) -> None:
    """Write a mesh as OBJ, with its materials and pictures beside it under the same name, or as GLB.

    path: ends in ``.obj`` or ``.glb``; missing folders are made. vertices: [V, 3] floating. faces: [F, 3] integer.
    skin: the colours, clamped to [0, 1]. Faces without an image share one more, with a tile for each. Raises TypeError
    or ValueError for other suffixes, for NaN and for what is no mesh.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in (".obj", ".glb"):
        raise ValueError(f"path: expected a name that ends in .obj or .glb, got {path.name!r}")
    points, corners, _ = mesh_to_write(vertices, faces)
    parts = _parts(skin)
    path.parent.mkdir(parents=True, exist_ok=True)
    if suffix == ".obj":
        _save_obj(path, points, corners, parts)
    else:
        _save_glb(path, points, corners, parts)


def _parts(skin: Skin) -> list[_Part]:
    found = []
    for number, (image, wrapping) in enumerate(zip(skin.images, skin.wrapping, strict=True)):
        own = np.flatnonzero(skin.image == number)
        if len(own):
            pixels = (image.clip(0, 1) * 255 + 0.5).astype(np.uint8)
            found.append(_Part(own, skin.uv[own], Image.fromarray(pixels), wrapping != "REPEAT"))
    plain = np.flatnonzero(skin.image < 0)
    if len(plain):
        pixels, place = build_atlas(bake_corners(skin.colors[plain].clip(0, 1), 2))
        found.append(_Part(plain, coordinates(place, pixels), Image.fromarray(pixels), True))
    return found


def _save_obj(path: Path, points: np.ndarray, corners: np.ndarray, parts: list[_Part]) -> None:
    text = [f"# {path.name}\n#\n\nmtllib {path.stem}.mtl\n\n", format_lines("v %.9g %.9g %.9g\n", points)]
    materials, pictures, before = [], {}, 1
    for number, part in enumerate(parts, 1):
        name = f"{path.stem}.png" if len(parts) == 1 else f"{path.stem}_{number}.png"
        pictures[name] = part.picture
        materials.append(format_material(number, name, part.clamp))
        places, place = np.unique(part.uv.reshape(-1, 2), axis=0, return_inverse=True)
        text.append("\n" + format_lines("vt %.9g %.9g\n", places) + f"\nusemtl material_{number}\n")
        both = np.stack([corners[part.faces] + 1, place.reshape(-1, 3) + before], axis=2)
        text.append(format_lines("f %d/%d %d/%d %d/%d\n", both.reshape(-1, 6)))
        before += len(places)
    path.write_text("".join(text), encoding="utf-8")
    path.with_suffix(".mtl").write_text("\n".join(materials), encoding="utf-8")
    for name, picture in pictures.items():
        picture.save(path.with_name(name))


def _save_glb(path: Path, points: np.ndarray, corners: np.ndarray, parts: list[_Part]) -> None:
    import trimesh  # here, since importing it takes longer than most calls to this package

    scene = trimesh.Scene()
    for number, part in enumerate(parts, 1):
        # A vertex has one place on the picture there: one that has several becomes as many.
        both = np.concatenate([corners[part.faces].reshape(-1, 1), part.uv.reshape(-1, 2)], axis=1)
        own, index = np.unique(both, axis=0, return_inverse=True)
        mesh = with_picture(points[own[:, 0].astype(int)], index.reshape(-1, 3), own[:, 1:], part.picture)
        scene.add_geometry(mesh, geom_name=f"part_{number}")
    scene.export(path, file_type="glb")


def with_picture(points: np.ndarray, corners: np.ndarray, uv: np.ndarray, picture: Image.Image) -> trimesh.Trimesh:
    """A mesh that shows a picture as it is, matt and from both sides; uv: [V, 2], where its vertices are on it."""
    import trimesh

    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=picture, metallicFactor=0.0, roughnessFactor=1.0, doubleSided=True
    )
    visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    return trimesh.Trimesh(points, corners, visual=visual, process=False)
