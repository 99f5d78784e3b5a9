"""Wavefront OBJ files with their materials, read by `load_obj`."""

from __future__ import annotations

import functools
import os
import re
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from .cubes import WRAPPINGS
from .files import existing, fits_float32, short, warn
from .images import load_image
from .mtl import Material, read_mtl
from .named_files import find_file
from .parse import ObjFile, read_obj
from .surface_colors import Skin


def load_obj(
    filename_obj: str | os.PathLike[str],
    normalization: bool = True,
    texture_size: int = 4,
    load_texture: bool = False,
    texture_wrapping: str = "REPEAT",
    use_bilinear: bool = True,
    allow_outside: bool = False,
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
        allow_outside: Read materials and images outside the file's folder too, if it names such; for files of people
            whom you trust.

    Returns:
        On the CPU: vertices, float32 [V, 3]; faces, int32 [F, 3]; and with ``load_texture`` also textures, float32
        [F, T, T, T, 3] in [0, 1]. A face has its material's image (``map_Kd``), else its colour (``Kd``), else the
        blended colours of its vertices (``v x y z r g b``), else, and for vertices without a colour, grey 0.5.

    Raises:
        FileNotFoundError: There is no such file.
        ValueError: Something in it cannot be read, is NaN, out of range or beyond float32, or there are no faces (file
            and line are named); its vertices all coincide and are to be normalised; the textures would exceed 8 GiB; an
            image is none or too large (see `load_image`); or it names files outside its folder by ``..`` without
            ``allow_outside``.

    Warns:
        UserWarning: A material file, an image or a material is missing, or there is no colour at all.
    """
    obj = read_obj(existing(filename_obj), with_uv=load_texture)
    vertices = _normalized(obj) if normalization else obj.vertices
    geometry = torch.from_numpy(vertices.astype(np.float32)), torch.from_numpy(obj.faces.astype(np.int32))
    if not load_texture:
        return geometry
    skin = obj_skin(obj, texture_wrapping, allow_outside)
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


def obj_skin(
    obj: ObjFile,
    wrapping: str = "REPEAT",
    allow_outside: bool = False,
    materials: dict[str, Material] | None = None,
) -> Skin | None:
    """Resolve the colours of a file read with ``with_uv=True``; None if it has no colours. Missing ones are grey.

    Args:
        obj: The file.
        wrapping: How texture coordinates beyond [0, 1] are wrapped.
        allow_outside: Read materials and images outside the file's folder, too.
        materials: Used in place of those in the material files that the file names.

    Raises ValueError as `load_obj` does. Warns (UserWarning) about missing material files, materials, images and
    texture coordinates, naming the file.
    """
    if wrapping not in WRAPPINGS:
        raise ValueError(f"texture_wrapping: expected one of {', '.join(WRAPPINGS)}, got {wrapping!r}")
    skin = Skin.plain(len(obj.faces), 0.5)
    materials = _materials(obj, allow_outside) if materials is None else materials
    load = functools.cache(_pixels)  # materials often share an image
    coloured = False
    if np.isfinite(obj.colours).any():
        skin.colors[:] = np.nan_to_num(obj.colours, nan=0.5)[obj.faces]
        coloured = True
    order = np.argsort(obj.material, kind="stable")  # each material's faces, after those of none
    groups = np.split(order, np.searchsorted(obj.material[order], np.arange(len(obj.names))))[1:]
    for name, chosen in zip(obj.names, groups, strict=True):
        material = materials.get(name)
        if material is None:
            if materials:
                warn(f"{obj.path}: material {short(name)} is in none of its material files")
            continue
        if material.colour is not None:
            skin.colors[chosen] = material.colour
            coloured = True
        if material.image is not None and len(chosen):
            path = find_file(obj.path, material.image, material.folder, obj.path.parent, allow_outside=allow_outside)
            if path is None:
                _warn_missing(obj, "image", material.image, allow_outside)
                continue
            _paint(skin, chosen, material, obj, load(path), wrapping)
            coloured = True
    return skin if coloured or obj.libraries else None


def _pixels(path: Path) -> np.ndarray:
    return np.ascontiguousarray(load_image(path)[..., :3].numpy())


def _paint(skin: Skin, chosen: np.ndarray, material: Material, obj: ObjFile, image: np.ndarray, wrapping: str) -> None:
    """Paint those of the chosen faces that have texture coordinates with their material's image."""
    with np.errstate(over="ignore", invalid="ignore"):
        uv = obj.uv[chosen] * material.scale + material.offset
    placed = fits_float32(uv).all(axis=(1, 2))
    if not placed.all():
        missing, name = int((~placed).sum()), short(material.image)
        warn(f"{obj.path}: {missing} faces have no texture coordinates for the image {name}")
    skin.paint(chosen[placed], image, uv[placed], "CLAMP_TO_EDGE" if material.clamp else wrapping)


def _materials(obj: ObjFile, allow_outside: bool) -> dict[str, Material]:
    find = functools.partial(find_file, obj.path, allow_outside=allow_outside)
    materials: dict[str, Material] = {}
    for text in dict.fromkeys(obj.libraries):
        whole = find(text.strip('"'))
        if whole is not None:
            materials |= read_mtl(whole)
            continue
        # Not one name with spaces, then: several names, in which "\ " is a space.
        for name in re.split(r"(?<!\\)\s+", text):
            path = find(name.replace("\\ ", " "))
            if path is None:
                _warn_missing(obj, "material file", name, allow_outside)
            else:
                materials |= read_mtl(path)
    return materials


def _warn_missing(obj: ObjFile, what: str, name: str, allow_outside: bool) -> None:
    unseen = Path(name).is_absolute() and not allow_outside
    hint = " in its folder; allow_outside=True (--allow-outside) looks where its path leads, too" if unseen else ""
    warn(f"{obj.path}: its {what} {short(name)} is missing{hint}")
