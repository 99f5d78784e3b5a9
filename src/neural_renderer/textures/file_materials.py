"""Materials of a `UVMesh` from and to the arrays of readers and writers."""

from __future__ import annotations

from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor

from ..io.surface_colors import FileTexture, SurfaceColors
from .material import Material, Texture
from .sample_texture import Wrap, wrap_pair

if TYPE_CHECKING:
    from ..meshes.uv_mesh import UVMesh

_WRAPS = {"REPEAT": "repeat", "CLAMP_TO_EDGE": "clamp", "CLAMP_TO_BORDER": "clamp", "MIRRORED_REPEAT": "mirror"}
_WRAPPINGS = {"repeat": "REPEAT", "clamp": "CLAMP_TO_EDGE", "mirror": "MIRRORED_REPEAT"}


def wrap_of(wrapping: str | tuple[str, str]) -> Wrap:
    """Convert a wrapping of `SurfaceColors`, or a pair of them."""
    if isinstance(wrapping, tuple):
        return _WRAPS[wrapping[0]], _WRAPS[wrapping[1]]
    return _WRAPS[wrapping]


def wrapping(wrap: Wrap) -> str | tuple[str, str]:
    """Convert a mode, or a pair of them, to a wrapping of `SurfaceColors`."""
    u, v = (_WRAPPINGS[mode] for mode in wrap_pair(wrap))
    return u if u == v else (u, v)


def attributes_of_file(surface: SurfaceColors) -> dict[str, Any]:
    """Convert what a file has beside colours to the optional attributes of `UVMesh`."""
    images: dict[int, Tensor] = {}  # so that textures that share an array share a tensor

    def value(part: Any) -> Any:
        if not isinstance(part, FileTexture):
            return part
        image = images.setdefault(id(part.image), torch.from_numpy(part.image).float())
        return Texture(image, *part[1:])

    tensors = {name: getattr(surface, name) for name in ("normals", "tangents", "uv1")}
    known = {name: torch.from_numpy(array).float() for name, array in tensors.items() if array is not None}
    if surface.material is not None:
        known["material_index"] = torch.from_numpy(surface.material).long()
    arguments = [{name: value(part) for name, part in one.items()} for one in surface.materials]
    return {**known, "materials": tuple(Material(**one) for one in arguments)}


def arrays_of_materials(mesh: UVMesh) -> dict[str, Any]:
    """Convert the optional attributes of a mesh to those of `SurfaceColors`."""
    images: dict[int, np.ndarray] = {}

    def value(part: Any) -> Any:
        if isinstance(part, Texture):
            image = images.setdefault(id(part.image), part.image.detach().float().cpu().numpy())
            offset, scale = (tuple(pair.tolist()) for pair in (part.offset, part.scale))
            return FileTexture(image, part.wrap, offset, scale, float(part.rotation), part.uv_set)
        return part.detach().cpu().tolist() if isinstance(part, Tensor) else part

    materials = [
        {one.name: value(getattr(material, one.name)) for one in fields(material)} for material in mesh.materials
    ]
    index = mesh.material_index
    if index is None and materials:
        index = torch.zeros(len(mesh.faces), dtype=torch.int64)
    tensors = {name: getattr(mesh, name) for name in ("normals", "tangents", "uv1")}
    arrays = {name: None if v is None else v.detach().double().cpu().numpy() for name, v in tensors.items()}
    return {**arrays, "materials": materials, "material": None if index is None else index.long().cpu().numpy()}
