"""Kernels that images will need, compiled together before the first of them runs."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

import torch
from torch import Tensor

from .colors.composite import composite
from .colors.interpolate import interpolate
from .colors.light_pixels import light_pixels
from .colors.mipmaps import sample_mipmaps
from .colors.texture_cubes import sample_textures
from .ops.barycentrics import barycentrics
from .ops.corners import gather_corners
from .ops.coverage import coverage
from .ops.flat_light import flat_light
from .ops.pinhole import pinhole
from .ops.visible_faces import seen_faces
from .settings import Settings
from .visibility.continuity import texture_edge_hashes
from .visibility.edge import boundaries
from .visibility.intersections import add_intersections
from .visibility.neighbors import neighbors
from .visibility.nmr import nmr_edges
from .visibility.scanlines import empty_lines
from .warp.launch import load_ahead
from .warp.registration import is_plain

Functions = tuple[Callable[..., Any], ...]

CUBES: Functions = (sample_textures, flat_light)
ATTRIBUTES: Functions = (interpolate, composite)
IMAGES: Functions = (interpolate, composite, sample_mipmaps, light_pixels, flat_light)
_ALWAYS: Functions = (coverage, gather_corners, pinhole)
_VISIBILITY: dict[str, Functions] = {
    "nmr": (nmr_edges, empty_lines, seen_faces),
    "edge": (boundaries, add_intersections, neighbors, seen_faces),
}


def load_kernels(settings: Settings, outputs: Collection[str], colors: Functions, corners: Tensor) -> None:
    """Compile the kernels that images of these corners or vertices need, unless they are in the cache.

    Any other kernel is compiled when it first runs.

    Args:
        settings: How faces are drawn.
        outputs: Some of "rgb", "alpha", "depth".
        colors: Operators that colour the faces if "rgb" is among the outputs: CUBES, ATTRIBUTES or IMAGES.
        corners: Positions on the device where images are drawn.
    """
    if not is_plain((corners,)):
        return
    moving = corners.requires_grad and torch.is_grad_enabled()
    # The modules that take longest to compile come first.
    needed: Functions = _VISIBILITY[settings.gradient] if moving else ()
    if "rgb" in outputs:
        needed += colors
        if moving and settings.gradient == "edge" and colors == CUBES:
            needed += (texture_edge_hashes,)
    if "depth" in outputs:
        needed += (barycentrics,)
    load_ahead(needed + _ALWAYS, corners.device)
