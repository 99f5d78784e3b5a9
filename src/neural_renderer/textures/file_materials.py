"""Conversion of a `UVMesh`'s materials from and to the arrays of readers and writers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..io.surface_colors import FileTexture
from .material import Material, Texture
from .sample_texture import Wrap, wrap_pair

_WRAPS = {"REPEAT": "repeat", "CLAMP_TO_EDGE": "clamp", "CLAMP_TO_BORDER": "clamp", "MIRRORED_REPEAT": "mirror"}
_WRAPPINGS = {"repeat": "REPEAT", "clamp": "CLAMP_TO_EDGE", "mirror": "MIRRORED_REPEAT"}


def wrap_of(wrapping: str | tuple[str, str]) -> Wrap:
    """Convert a wrapping of `SurfaceColors`, or a pair for u and v, to modes of `sample_texture`."""
    if isinstance(wrapping, tuple):
        return _WRAPS[wrapping[0]], _WRAPS[wrapping[1]]
    return _WRAPS[wrapping]


def wrapping(wrap: Wrap) -> str | tuple[str, str]:
    """Convert a mode, or a pair for u and v, to a wrapping of `SurfaceColors`."""
    u, v = (_WRAPPINGS[mode] for mode in wrap_pair(wrap))
    return u if u == v else (u, v)


def materials_of_file(materials: Sequence[dict[str, Any]]) -> tuple[Material, ...]:
    """Convert the materials of `SurfaceColors` to `Material`."""
    images: dict[int, Tensor] = {}  # tensor of each array, which textures may share

    def value(part: Any) -> Any:
        if not isinstance(part, FileTexture):
            return part
        image = images.setdefault(id(part.image), torch.from_numpy(part.image).float())
        return Texture(image, *part[1:])

    return tuple(Material(**{name: value(part) for name, part in one.items()}) for one in materials)


def arrays_of_materials(materials: Sequence[Material]) -> list[dict[str, Any]]:
    """Convert materials to the form of `SurfaceColors`."""
    images: dict[int, np.ndarray] = {}

    def value(part: Any) -> Any:
        if isinstance(part, Texture):
            image = images.setdefault(id(part.image), part.image.detach().float().cpu().numpy())
            offset, scale = (tuple(pair.tolist()) for pair in (part.offset, part.scale))
            return FileTexture(image, part.wrap, offset, scale, float(part.rotation), part.uv_set)
        return part.detach().cpu().tolist() if isinstance(part, Tensor) else part

    return [{one.name: value(getattr(material, one.name)) for one in fields(material)} for material in materials]
