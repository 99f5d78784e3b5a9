"""The first packages' modules by their old names, for ``from neural_renderer.projection import projection``.

They are made when the package is imported and exist in `sys.modules` only: a file of that name would, once imported,
take the place of the function of the same name in ``neural_renderer``.
"""

from __future__ import annotations

import os
import sys
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .. import validate
from ..camera import get_points_from_angles, look, look_at, perspective, projection
from ..io import load_obj, save_obj
from ..io.atlas import build_atlas
from ..io.cubes import check_size
from ..io.files import existing
from ..io.mtl import read_mtl
from ..io.obj import obj_skin
from ..io.parse import read_obj
from ..io.surface_colors import Skin
from ..meshes.mesh import Mesh
from ..raster import vertices_to_faces
from . import rasterize as _rasterize
from .adam import Adam
from .lighting import lighting
from .rasterize import Rasterize, rasterize, rasterize_depth, rasterize_rgbad, rasterize_silhouettes
from .renderer import Renderer


def cross(a: Tensor, b: Tensor) -> Tensor:
    """The cross products [N, 3] of vectors [N, 3]; `torch.linalg.cross` does the same for any shape."""
    validate.floating("a", a, ("N", 3))
    return torch.linalg.cross(a, validate.floating("b", b, (len(a), 3)))


def load_mtl(filename_mtl: str | os.PathLike[str]) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """The colours (Kd, [3] float64) and the names of the images (map_Kd) in an MTL file, by material."""
    materials = read_mtl(existing(filename_mtl))
    colors = {name: np.array(material.colour) for name, material in materials.items() if material.colour is not None}
    images = {name: material.image for name, material in materials.items() if material.image is not None}
    return colors, images


def load_textures(
    filename_obj: str | os.PathLike[str],
    filename_mtl: str | os.PathLike[str],
    texture_size: int,
    texture_wrapping: str = "REPEAT",
    use_bilinear: bool = True,
) -> Tensor:
    """The textures [F, T, T, T, 3] of an OBJ file under the materials of an MTL file; otherwise as `load_obj`."""
    obj = read_obj(existing(filename_obj), with_uv=True)
    check_size(len(obj.faces), texture_size)
    skin = obj_skin(obj, texture_wrapping, read_mtl(existing(filename_mtl))) or Skin.plain(len(obj.faces), 0.5)
    return torch.from_numpy(skin.bake(texture_size, use_bilinear))


def create_texture_image(textures: Tensor, texture_size_out: int = 16) -> tuple[np.ndarray, np.ndarray]:
    """One picture with a tile of ``texture_size_out``² pixels, at least 4², for each face's cube [F, T, T, T, 3].

    Returns the picture [H, W, 3] float32 in [0, 1], first row on top, and the texture coordinates [F, 3, 2] float32 of
    the faces' corners, 0 and 1 at the centres of its outermost pixels, v up. Tiles of similar colour lie together.
    """
    cubes = validate.cubes("textures", textures, "F").detach().cpu().float().clamp(0, 1).numpy()
    picture, pixels = build_atlas(cubes, validate.whole("texture_size_out", texture_size_out, 4))
    height, width = picture.shape[:2]
    uv = pixels / [width - 1, height - 1] * [1, -1] + [0, 1]
    return picture.astype(np.float32) / 255, uv.astype(np.float32)


class RasterizeFunction:
    """`Rasterize` as the torch function that it was: only ``RasterizeFunction.apply``."""

    @staticmethod
    def apply(faces: Tensor, textures: Tensor | None, *settings: Any) -> tuple[Tensor | None, ...]:
        """``Rasterize(*settings)(faces, textures)``."""
        return Rasterize(*settings)(faces, textures)


_MODULES: dict[str, tuple[Any, ...]] = {
    "cross": (cross,),
    "get_points_from_angles": (get_points_from_angles,),
    "lighting": (lighting,),
    "load_obj": (load_obj, load_mtl, load_textures),
    "look": (look,),
    "look_at": (look_at,),
    "mesh": (Mesh,),
    "optimizers": (Adam,),
    "perspective": (perspective,),
    "projection": (projection,),
    "rasterize": (
        rasterize,
        rasterize_rgbad,
        rasterize_silhouettes,
        rasterize_depth,
        Rasterize,
        RasterizeFunction,
    ),
    "renderer": (Renderer,),
    "save_obj": (save_obj, create_texture_image),
    "vertices_to_faces": (vertices_to_faces,),
}


class _NoExtensions:
    """Tells what to use where a program imports the first packages' compiled parts, which have no place here."""

    @staticmethod
    def find_spec(name: str, path: Any = None, target: Any = None) -> None:
        if f"{name}.".startswith(f"{_package()}.cuda."):
            raise ImportError(
                f"{name}: this package has no compiled extensions; in their place call {_package()}.rasterize_rgbad, "
                "load_obj(..., load_texture=True) or save_obj, which run on every device",
                name=name,
            )


def register() -> None:
    """Make the modules, and those known to the package whose names are not its functions' (renderer, mesh, …)."""
    package = sys.modules[_package()]
    for name, members in _MODULES.items():
        module = ModuleType(f"{_package()}.{name}", f"`{name}` under the name that it had in the first packages.")
        module.__spec__ = ModuleSpec(module.__name__, None)
        module.__dict__.update({member.__name__: member for member in members})
        sys.modules[module.__name__] = module
        if not hasattr(package, name):
            setattr(package, name, module)
    defaults = {name: value for name, value in vars(_rasterize).items() if name.startswith("DEFAULT_")}
    sys.modules[f"{_package()}.rasterize"].__dict__.update(defaults)
    sys.meta_path.append(_NoExtensions)


def _package() -> str:
    return __name__.partition(".")[0]
