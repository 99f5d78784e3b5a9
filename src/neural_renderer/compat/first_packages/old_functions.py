"""Functions of the first packages' modules. Only `cross` is exported by ``neural_renderer``."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...base import constants, validate
from ...io.atlas import build_atlas
from ...io.cubes import check_size
from ...io.files import existing
from ...io.obj import obj_surface_colors
from ...io.obj.mtl import read_mtl
from ...io.obj.parse import read_obj
from ...io.surface_colors import SurfaceColors
from .rasterize import Rasterize


def cross(a: Tensor, b: Tensor) -> Tensor:
    """Compute cross products. New code uses `torch.linalg.cross`.

    Args:
        a, b: [N, 3] floating.

    Returns:
        [N, 3], differentiable.

    Raises:
        TypeError, ValueError: A type or shape does not fit.

    Example:
        >>> cross(torch.tensor([[1.0, 0.0, 0.0]]), torch.tensor([[0.0, 1.0, 0.0]]))
        tensor([[0., 0., 1.]])
    """
    validate.floating("a", a, ("N", 3))
    return torch.linalg.cross(a, validate.floating("b", b, (len(a), 3)))


def load_mtl(filename_mtl: str | os.PathLike[str]) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Read the colours (Kd, [3] float64) and the image names (map_Kd) of an MTL file, by material."""
    materials = read_mtl(existing(filename_mtl))
    colors = {
        name: np.array(material.colors["color"]) for name, material in materials.items() if "color" in material.colors
    }
    images = {name: material.maps["color"].image for name, material in materials.items() if "color" in material.maps}
    return colors, images


def load_textures(
    filename_obj: str | os.PathLike[str],
    filename_mtl: str | os.PathLike[str],
    texture_size: int,
    texture_wrapping: str = "REPEAT",
    use_bilinear: bool = True,
) -> Tensor:
    """Bake the materials of an MTL file into textures [F, T, T, T, 3] of an OBJ file, on the device of `load_obj`."""
    obj = read_obj(existing(filename_obj), with_uv=True)
    check_size(len(obj.faces), texture_size)
    surface = obj_surface_colors(obj, texture_wrapping, materials=read_mtl(existing(filename_mtl)))
    surface = surface or SurfaceColors.plain(len(obj.faces), 0.5)
    return torch.from_numpy(surface.bake(texture_size, use_bilinear)).to(constants.old_device())


def create_texture_image(textures: Tensor, texture_size_out: int = 16) -> tuple[np.ndarray, np.ndarray]:
    """Bake texture cubes [F, T, T, T, 3] into an atlas of tiles of ``texture_size_out`` ≥ 4 pixels, ordered by colour.

    Returns the image [H, W, 3] float32 in [0, 1], row 0 at the top, and the texture coordinates [F, 3, 2] float32 of
    the faces' corners (v up; 0 and 1 are the centres of the outermost pixels).
    """
    cubes = validate.cubes("textures", textures, "F").detach().cpu().float().clamp(0, 1).numpy()
    picture, pixels = build_atlas(cubes, validate.whole("texture_size_out", texture_size_out, 4))
    height, width = picture.shape[:2]
    uv = pixels / [width - 1, height - 1] * [1, -1] + [0, 1]
    return picture.astype(np.float32) / 255, uv.astype(np.float32)


class RasterizeFunction:
    """`Rasterize` as a torch function; only ``RasterizeFunction.apply`` exists."""

    @staticmethod
    def apply(faces: Tensor, textures: Tensor | None, *settings: Any) -> tuple[Tensor | None, ...]:
        """Call ``Rasterize(*settings)(faces, textures)``."""
        return Rasterize(*settings)(faces, textures)
