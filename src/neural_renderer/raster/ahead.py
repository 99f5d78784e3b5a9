"""Kernels that images will need, compiled in parallel before the first of them runs."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

from torch import Tensor

from .colors.composite import composite
from .colors.interpolate import interpolate
from .colors.light_pixels import light_pixels
from .colors.mipmaps import sample_mipmaps
from .colors.texture_cubes import sample_textures
from .ops.barycentrics import barycentrics
from .ops.corners import gather_corners
from .ops.coverage import coverage
from .ops.draw import DrawingKernels
from .ops.flat_light import flat_light
from .ops.project_corners import project_corners
from .settings import Settings
from .warp.launch import load_ahead
from .warp.layout import in_any_order
from .warp.registration import is_plain, needs_gradient

Functions = tuple[Callable[..., Any], ...]

CUBES: Functions = (sample_textures,)
ATTRIBUTES: Functions = (interpolate, composite)
IMAGES: Functions = (interpolate, composite, sample_mipmaps, light_pixels)
PROJECTION: Functions = (project_corners,)
SCENE: Functions = (*PROJECTION, flat_light)
_ALWAYS: Functions = (coverage, DrawingKernels, gather_corners)


def load_kernels(
    settings: Settings, outputs: Collection[str], colors: Functions, *positions: Tensor, scene: Functions = ()
) -> None:
    """Compile the kernels that images need, unless they are cached. Others are compiled when they first run.

    ``colors`` are CUBES, ATTRIBUTES or IMAGES, for "rgb" among the outputs. ``positions`` are corners, or vertices and
    camera parameters, the first on the device of the images. ``scene`` is SCENE to project
    and light vertices, PROJECTION only to project them.
    """
    if not isinstance(positions[0], Tensor) or not is_plain(positions):
        return
    moving = needs_gradient(*positions)
    # The modules that take longest to compile come first.
    cubes = "rgb" in outputs and colors == CUBES and in_any_order(positions[0].device)
    needed: Functions = settings.gradient.operators(set(outputs) == {"alpha"}, cubes) if moving else ()
    needed += (*scene, *colors) if "rgb" in outputs else scene[: len(PROJECTION)]
    if "depth" in outputs:
        needed += (barycentrics,)
    load_ahead(needed + _ALWAYS, positions[0].device, moving)
