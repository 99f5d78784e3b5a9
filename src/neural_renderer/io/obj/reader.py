"""Reading of Wavefront OBJ files with materials: `load_obj`."""

from __future__ import annotations

import functools
import os
import re
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ...base import constants
from ..files import existing, fits_float32, short, warn
from ..image_formats.pictures import PictureSum
from ..images import load_image
from ..named_files import find_file
from ..surface_colors import SurfaceColors
from .mtl import Map, Material, material_arguments, read_mtl
from .parse import ObjFile, read_obj

_NAMED = 10  # missing files that are named; more are counted
_WRAPS = {"REPEAT": "repeat", "MIRRORED_REPEAT": "mirror", "CLAMP_TO_EDGE": "clamp", "CLAMP_TO_BORDER": "border"}


def load_obj(
    filename_obj: str | os.PathLike[str],
    normalization: bool = True,
    texture_size: int = 4,
    load_texture: bool = False,
    texture_wrapping: str = "REPEAT",
    use_bilinear: bool = True,
    allow_outside: bool = False,
) -> tuple[Tensor, Tensor] | tuple[Tensor, Tensor, Tensor]:
    """Read an OBJ file, and bake its colours into texture cubes if asked.

    Vertices and faces keep the file's order. Convex polygons become triangle fans, concave ones are triangulated by ear
    clipping. Points and lines are ignored. The text may be UTF-8, UTF-16 or Latin-1.

    Args:
        filename_obj: Path of the file.
        normalization: Move the bounding box to the origin and scale its longest side to [−1, 1].
        texture_size, allow_outside: As in `load_mesh`.
        load_texture: Return textures, too.
        texture_wrapping: Wrapping of texture coordinates outside [0, 1]: ``"REPEAT"``, ``"MIRRORED_REPEAT"``,
            ``"CLAMP_TO_EDGE"`` or ``"CLAMP_TO_BORDER"`` (black).
        use_bilinear: Interpolate between pixels of an image; otherwise take the nearest one.

    Returns:
        Vertices [V, 3] float32 and faces [F, 3] int32; with ``load_texture`` also textures [F, T, T, T, 3] float32 in
        [0, 1]. They are on torch's default device if one is set (`torch.set_default_device`), else on CUDA if there is
        one. A face has the image of its material (``map_Kd``), else its colour (``Kd``), else the interpolated colours
        of its vertices (``v x y z r g b``), else grey 0.5.

    Raises:
        FileNotFoundError, ValueError: As `load_mesh`, with the line of a wrong statement; or, with ``normalization``,
            all vertices coincide.

    Warns:
        UserWarning: A material file, an image or a material is missing, or the file has no colours.

    Example:
        >>> nr.save_obj("cube.obj", *nr.cube())
        >>> vertices, faces = nr.load_obj("cube.obj")
    """
    obj = read_obj(existing(filename_obj), with_uv=load_texture)
    vertices = _normalized(obj) if normalization else obj.vertices
    device, vertices, faces = constants.old_device(), vertices.astype(np.float32), obj.faces.astype(np.int32)
    geometry = torch.from_numpy(vertices).to(device), torch.from_numpy(faces).to(device)
    if not load_texture:
        return geometry
    surface = obj_surface_colors(obj, texture_wrapping, allow_outside)
    if surface is None:
        if not obj.libraries:
            warn(f"{obj.path}: no mtllib and no vertex colours; the texture is grey")
        surface = SurfaceColors.plain(len(obj.faces), 0.5)
    return *geometry, torch.from_numpy(surface.bake(texture_size, use_bilinear)).to(device)


def _normalized(obj: ObjFile) -> np.ndarray:
    """Scale vertices into [−1, 1], in float64, so that a small mesh far from the origin keeps its shape."""
    vertices = obj.vertices - obj.vertices.min(axis=0)
    longest = vertices.max()
    if longest == 0:
        raise ValueError(f"{obj.path}: expected vertices to normalise, got {len(vertices)} that all coincide")
    vertices = vertices / longest * 2
    return vertices - vertices.max(axis=0) / 2


def obj_surface_colors(
    obj: ObjFile,
    wrapping: str = "REPEAT",
    allow_outside: bool = False,
    materials: dict[str, Material] | None = None,
    with_materials: bool = False,
) -> SurfaceColors | None:
    """Collect the surface colours of an OBJ file read with ``with_uv``; None without colours and material files.

    ``materials`` by name take the place of those in the material files; ``with_materials`` collects them and normals,
    too. Faces without a colour are grey 0.5.
    """
    if wrapping not in _WRAPS:
        raise ValueError(f"texture_wrapping: expected one of {', '.join(_WRAPS)}, got {wrapping!r}")
    surface = SurfaceColors.plain(len(obj.faces), 0.5)
    materials = obj_materials(obj, allow_outside) if materials is None else materials
    load, all_pictures = functools.cache(_pixels), PictureSum()  # materials may share an image
    finder = _Finder(obj, "image", allow_outside)
    has_color = False
    if np.isfinite(obj.colors).any():
        surface.colors[:] = np.nan_to_num(obj.colors, nan=0.5)[obj.faces]
        has_color = True
    order = np.argsort(obj.material, kind="stable")  # faces without a material first, then by material
    groups = np.split(order, np.searchsorted(obj.material[order], np.arange(len(obj.names))))[1:]
    for name, chosen in zip(obj.names, groups, strict=True):
        material = materials.get(name)
        if material is None:
            if materials:
                warn(f"{obj.path}: material {short(name)} is not in its material files")
            continue
        if "color" in material.colors:
            surface.colors[chosen] = material.colors["color"]
            has_color = True
        if not len(chosen):
            continue
        base = material.maps.get("color")

        def image(used: Map, material: Material = material) -> np.ndarray | None:
            path = finder.find(used.image, material.folder, obj.path.parent)
            if path is None:
                finder.miss(used.image)
            return None if path is None else load(path, all_pictures)

        pixels = None if base is None else image(base)
        if base is not None and pixels is not None:
            _paint(surface, chosen, base, obj, pixels, _WRAPS[wrapping])
            has_color = True
        if with_materials:
            if pixels is None:
                base = None
                placed = fits_float32(obj.uv[chosen]).all(axis=(1, 2))
                surface.uv[chosen[placed]] = obj.uv[chosen[placed]]
            if surface.material is None:
                surface.material = np.full(len(obj.faces), -1)
            surface.material[chosen] = len(surface.materials)
            surface.materials.append(material_arguments(name, material, base, image))
    finder.end()
    if with_materials:
        surface.normals = obj.normals
        surface.has_colors = has_color or bool(obj.libraries)
        return surface if surface.has_colors or surface.normals is not None else None
    return surface if has_color or obj.libraries else None


def _pixels(path: Path, all_pictures: PictureSum) -> np.ndarray:
    pixels = load_image(path).numpy()
    all_pictures.add(path, pixels.shape[0] * pixels.shape[1], path.stat().st_size)
    return pixels


def _paint(surface: SurfaceColors, chosen: np.ndarray, used: Map, obj: ObjFile, image: np.ndarray, wrap: str) -> None:
    """Assign a material's image to the chosen faces that have texture coordinates."""
    with np.errstate(over="ignore", invalid="ignore"):
        uv = obj.uv[chosen] * used.scale + used.offset
    placed = fits_float32(uv).all(axis=(1, 2))
    if not placed.all():
        missing, name = int((~placed).sum()), short(used.image)
        warn(f"{obj.path}: {missing} faces have no texture coordinates for the image {name}")
    image = surface.opaque(image)
    surface.paint(chosen[placed], image, uv[placed], "clamp" if used.clamp else wrap)


def obj_materials(obj: ObjFile, allow_outside: bool) -> dict[str, Material]:
    finder = _Finder(obj, "material file", allow_outside)
    paths: list[Path] = []
    for text in dict.fromkeys(obj.libraries):
        whole = finder.find(text.strip('"'))
        if whole is not None:
            paths.append(whole)
            continue
        # The text is not one name with spaces. Read it as several names, in which "\ " is a space.
        for name in re.split(r"(?<!\\)\s+", text):
            path = finder.find(name.replace("\\ ", " "))
            if path is None:
                finder.miss(name)
            else:
                paths.append(path)
    finder.end()
    materials: dict[str, Material] = {}
    for path in reversed(dict.fromkeys(reversed(paths))):  # each once; the last one of a name counts
        materials |= read_mtl(path)
    return materials


class _Finder:
    """Search for one kind of the files that an OBJ file names; warns about missing ones, and counts those after ten."""

    def __init__(self, obj: ObjFile, what: str, allow_outside: bool) -> None:
        self._obj, self._what, self._allow_outside, self._missing = obj, what, allow_outside, 0
        self.find = functools.partial(find_file, obj.path, allow_outside=allow_outside, listings={})

    def miss(self, name: str) -> None:
        """Warn about a missing file; mention ``allow_outside`` if its path is absolute."""
        self._missing += 1
        elsewhere = Path(name).is_absolute() and not self._allow_outside
        hint = " in its folder; allow_outside=True searches its path, too" if elsewhere else ""
        if self._missing <= _NAMED:
            warn(f"{self._obj.path}: its {self._what} {short(name)} is missing{hint}")

    def end(self) -> None:
        """Say how many more files are missing."""
        if self._missing > _NAMED:
            warn(f"{self._obj.path}: {self._missing - _NAMED:,} more of its {self._what}s are missing")
