"""Wavefront OBJ with its materials: `load_obj` and `save_obj`."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from .atlas import build_atlas
from .cubes import WRAPPINGS
from .files import existing, find_file, mesh_to_write, warn
from .images import load_image
from .mtl import Material, read_mtl
from .parse import ObjFile, read_obj
from .surface_colors import Skin


def load_obj(
    filename_obj: str | os.PathLike[str],
    normalization: bool = True,
    texture_size: int = 4,
    load_texture: bool = False,
    texture_wrapping: str = "REPEAT",
    use_bilinear: bool = True,
) -> tuple[Tensor, Tensor] | tuple[Tensor, Tensor, Tensor]:
    """Read a mesh from an OBJ file.

    Vertices and faces keep the file's order; polygons become triangles (a fan from their first corner, or ears where
    they are concave), points and lines are passed over. Text may be UTF-8, UTF-16 or Latin-1.

    Args:
        filename_obj: The file.
        normalization: Move the bounding box to the origin and scale its longest side to [-1, 1].
        texture_size: T, texels along a cube's edge, at least 1 (the colour at the face's centre).
        load_texture: Return colours too.
        texture_wrapping: Texture coordinates outside [0, 1]: ``"REPEAT"``, ``"MIRRORED_REPEAT"``,
            ``"CLAMP_TO_EDGE"`` or ``"CLAMP_TO_BORDER"`` (black).
        use_bilinear: Blend neighbouring pixels of an image, else take the nearest.

    Returns:
        On the CPU: vertices, float32 [V, 3]; faces, int32 [F, 3]; and with ``load_texture`` also textures, float32
        [F, T, T, T, 3] in [0, 1]. A face has its material's image (``map_Kd``), else its colour (``Kd``), else the
        blended colours of its vertices (``v x y z r g b``), else, and for vertices without a colour, grey 0.5.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: Something in it cannot be read, is NaN or out of range, or there are no faces (file and line are
            named); its vertices all coincide and are to be normalised; or the textures would exceed 8 GiB.

    Warns:
        UserWarning: A material file, an image or a material is missing, or there is no colour at all.
    """
    obj = read_obj(existing(filename_obj), with_uv=load_texture)
    vertices = _normalized(obj) if normalization else obj.vertices
    geometry = torch.from_numpy(vertices.astype(np.float32)), torch.from_numpy(obj.faces.astype(np.int32))
    if not load_texture:
        return geometry
    skin = obj_skin(obj, texture_wrapping)
    if skin is None:
        if not obj.libraries:
            warn(f"{obj.path}: no mtllib and no vertex colours, so its texture is grey")
        skin = Skin.plain(len(obj.faces), 0.5)
    return *geometry, torch.from_numpy(skin.bake(texture_size, use_bilinear))


def _normalized(obj: ObjFile) -> np.ndarray:
    """The vertices in [-1, 1]; in float64, so that a small mesh far from the origin keeps its shape."""
    vertices = obj.vertices - obj.vertices.min(axis=0)
    longest = vertices.max()
    if longest == 0:
        raise ValueError(f"{obj.path}: expected vertices to normalise, got {len(vertices)} that all coincide")
    vertices = vertices / longest * 2
    return vertices - vertices.max(axis=0) / 2


def obj_skin(obj: ObjFile, wrapping: str = "REPEAT") -> Skin | None:
    """The colours of a file read with ``with_uv=True``, or None if it names none at all; of what is missing, grey.

    Warns (UserWarning) about missing material files, materials, images and texture coordinates, naming the file.
    """
    if wrapping not in WRAPPINGS:
        raise ValueError(f"texture_wrapping: expected one of {', '.join(WRAPPINGS)}, got {wrapping!r}")
    skin = Skin.plain(len(obj.faces), 0.5)
    materials = _materials(obj)
    coloured = False
    if np.isfinite(obj.colours).any():
        skin.colors[:] = np.nan_to_num(obj.colours, nan=0.5)[obj.faces]
        coloured = True
    for index, name in enumerate(obj.names):
        material = materials.get(name)
        if material is None:
            if materials:
                warn(f"{obj.path}: material {name!r} is in none of its material files")
            continue
        chosen = np.flatnonzero(obj.material == index)
        if material.colour is not None:
            skin.colors[chosen] = material.colour
            coloured = True
        if material.image is not None and len(chosen):
            coloured |= _paint(skin, chosen, material, obj, wrapping)
    return skin if coloured or obj.libraries else None


def _paint(skin: Skin, chosen: np.ndarray, material: Material, obj: ObjFile, wrapping: str) -> bool:
    """Paint the chosen faces with their material's image, if there is one and they have texture coordinates."""
    name = material.image or ""
    path = find_file(name, material.folder, obj.path.parent)
    if path is None:
        warn(f"{obj.path}: its image {name!r} is missing")
        return False
    placed = chosen[np.isfinite(obj.uv[chosen]).all(axis=(1, 2))]
    if len(placed) < len(chosen):
        warn(f"{obj.path}: {len(chosen) - len(placed)} faces have no texture coordinates for the image {name!r}")
    uv = obj.uv[placed] * material.scale + material.offset
    image = load_image(path)[..., :3].numpy()
    skin.paint(placed, image, uv, "CLAMP_TO_EDGE" if material.clamp else wrapping)
    return True


def _materials(obj: ObjFile) -> dict[str, Material]:
    materials: dict[str, Material] = {}
    for text in dict.fromkeys(obj.libraries):
        whole = find_file(text.strip('"'), obj.path.parent)
        if whole is not None:
            materials |= read_mtl(whole)
            continue
        # Not one name with spaces, then: several names, in which "\ " is a space.
        for name in re.split(r"(?<!\\)\s+", text):
            path = find_file(name.replace("\\ ", " "), obj.path.parent)
            if path is None:
                warn(f"{obj.path}: its material file {name!r} is missing")
            else:
                materials |= read_mtl(path)
    return materials


def save_obj(filename: str | os.PathLike[str], vertices: Any, faces: Any, textures: Any = None) -> None:
    """Write a mesh as OBJ, with its colours as MTL and PNG beside it under the same name.

    Args:
        filename: Ends in ``.obj``; missing folders are made.
        vertices: [V, 3] float tensor or array, on any device; written so that float32 is read back exactly.
        faces: [F, 3] int32 or int64.
        textures: [F, T, T, T, 3] in [0, 1] (clamped), or None. Each face gets a tile of 15 × 15 to
            50 × 50 pixels (fewer above 290,000 faces) in the PNG, which holds what the renderer shows of its cube.

    Raises:
        TypeError, ValueError: As told for each argument; another suffix; too many faces for one picture.
    """
    path = Path(filename)
    if path.suffix.lower() != ".obj":
        raise ValueError(f"filename: expected a name that ends in .obj, got {path.name!r}")
    points, corners, cubes = mesh_to_write(vertices, faces, textures)
    text = [f"# {path.name}\n#\n\n"]
    if cubes is not None:
        picture, pixels = build_atlas(cubes)
        height, width = picture.shape[:2]
        uv = pixels / [width - 1, height - 1] * [1, -1] + [0, 1]
        text.append(f"mtllib {path.stem}.mtl\n\n")
    text.append(format_lines("v %.9g %.9g %.9g\n", points))
    if cubes is None:
        text.append("\n" + format_lines("f %d %d %d\n", corners + 1))
    else:
        text.append("\n" + format_lines("vt %.8f %.8f\n", uv.reshape(-1, 2)))
        order = np.arange(3 * len(corners)).reshape(-1, 3)
        text.append("\nusemtl material_1\n")
        text.append(format_lines("f %d/%d %d/%d %d/%d\n", np.stack([corners, order], axis=2).reshape(-1, 6) + 1))
    path.parent.mkdir(parents=True, exist_ok=True)
    if cubes is not None:
        Image.fromarray(picture).save(path.with_suffix(".png"))
        path.with_suffix(".mtl").write_text(format_material(1, f"{path.stem}.png"), encoding="utf-8")
    path.write_text("".join(text), encoding="utf-8")


def format_material(number: int, picture: str, clamp: bool = False) -> str:
    """The material ``material_<number>`` of an MTL file, which shows a picture as it is."""
    option = "-clamp on " if clamp else ""
    return f"newmtl material_{number}\nKa 1 1 1\nKd 1 1 1\nKs 0 0 0\nd 1\nillum 1\nmap_Kd {option}{picture}\n"


def format_lines(form: str, rows: np.ndarray) -> str:
    return (form * len(rows)) % tuple(rows.reshape(-1).tolist())
