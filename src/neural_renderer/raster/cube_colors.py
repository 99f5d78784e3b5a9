"""Colours from texture cubes, or colours of corners, under light, at every pixel."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.utils.weak import WeakTensorKeyDictionary

from ..base import private, validate
from ..base.recording import recorded
from .background import background_image
from .colors.downsample import in_blocks
from .colors.edge_hashes import CubeEdges
from .colors.texture_cubes import CornerColors, sample_textures
from .visible import VisibleFaces
from .warp.elementwise import joined
from .warp.registration import is_plain

_MANY = 1 << 16  # texels that take longer to read than to look up
_finite = WeakTensorKeyDictionary()  # by large texture: its state when all values were finite


@dataclass(frozen=True, eq=False)
class PackedCubes:
    """Texture cubes, or colours of corners, of B meshes with different numbers of faces, concatenated."""

    cubes: Tensor  # [N, T, T, T, 3] or [N, 3, 3] floating, N the sum of the meshes' numbers of faces
    firsts: Tensor  # first cube of each mesh, and N, [B + 1] int32


def cube_colors(
    visible: VisibleFaces, textures: Any, light: Tensor | None, background: Any, of_vertices: bool = False
) -> tuple[Tensor, Callable[[], Tensor] | None, CornerColors | None]:
    """Colour B images by texture cubes or colours of corners.

    Args:
        textures: Cubes [B or 1, F, T, T, T, 3] floating; T = 1 is one colour per face. Or colours of the faces'
            corners, [B or 1, F, 3, 3] floating. Or either of them packed.
        light: Factors [B or 1, 2, F, 3] on the front and the back of each face; None for 1.
        background: As in `background_image`.
        of_vertices: Whether faces that share a vertex have the same colour there.

    Returns:
        [B, 3, H, W] float32, perhaps `in_blocks`; and a function that hashes the colours along edges
        (`texture_edge_hashes`), None if they do not jump between adjacent faces; and the colours of corners, None if
        faces do not interpolate them.

    Raises TypeError for another dtype, and ValueError for another shape or device, or for NaN and infinity.
    """
    settings = visible.settings
    firsts = textures.firsts if isinstance(textures, PackedCubes) else None
    cubes, factors, behind = checked_colors(visible, textures, light, background, torch.float32)
    inside = visible.next_corners() if settings.gradient.differentiates_inside else visible.corners.detach()
    options = (visible.face_index, settings.eps, settings.perspective, firsts, *settings.drawn_strip)
    rgb = in_blocks(visible.in_blocks, sample_textures, cubes, factors, behind, inside, *options)
    interpolates = cubes.dim() == 4 or cubes.shape[2] == 1
    known = CornerColors(cubes, None if light is None and firsts is None else factors, firsts) if interpolates else None
    if of_vertices and light is None and visible.half_edges is not None and visible.half_edges.boundary == 0:
        return rgb, None, known
    return rgb, CubeEdges(cubes.detach(), factors.detach(), firsts), known


def checked_colors(
    visible: VisibleFaces, textures: Any, light: Tensor | None, background: Any, dtype: torch.dtype
) -> tuple[Tensor, Tensor, Tensor]:
    """Check the arguments of `cube_colors`, and convert them to those of `sample_textures`, in a dtype.

    Returns:
        Textures as they are given, or [1, N, ...] of packed ones, light [B or 1, 2, F, 3], background [B, 3, H, W].
    """
    corners = visible.corners
    batch, device = corners.shape[0], corners.device
    if isinstance(textures, PackedCubes):
        cubes = _fitting_textures(textures.cubes[None], 1, len(textures.cubes), corners).to(dtype)
        if len(textures.firsts) != batch + 1:
            raise ValueError(f"mesh: expected a list of {batch} meshes like cameras, got {len(textures.firsts) - 1}")
    else:
        cubes = _fitting_textures(textures, batch, corners.shape[1], corners).to(dtype)
    factors = _checked_light(light, corners).to(dtype)
    behind = background_image(background, batch, 3, visible.settings, device, dtype)
    return cubes, factors, behind.expand(batch, 3, *visible.face_index.shape[1:])


def checked_textures(textures: Any, *owners: str) -> Tensor:
    """Return textures if they are cubes [*owners, T, T, T, 3] or colours of corners [*owners, 3, 3], floating.

    Raises TypeError or ValueError.
    """
    if getattr(textures, "ndim", 0) == len(owners) + 2:
        return validate.floating("textures", textures, (*owners, 3, 3))
    return validate.cubes("textures", textures, *owners)


def _fitting_textures(textures: Any, batch: int, count: int, faces: Tensor) -> Tensor:
    if textures is None:
        raise ValueError('textures: expected a tensor [B, F, T, T, T, 3] to draw "rgb", got None')
    checked_textures(textures, "B", "F")
    validate.same_device(faces=faces, textures=textures)
    if textures.shape[0] not in (1, batch) or textures.shape[1] != count:
        raise ValueError(
            f"textures: expected [{batch} or 1, {count}, T, T, T, 3] like faces, got {validate.shape_of(textures)}"
        )
    _finite_once(textures)
    return textures


@recorded
def _finite_once(textures: Tensor) -> None:
    """Raise ValueError if a texel is not finite; large textures are read again only after an in-place change."""
    base = private.base_of(textures)
    version = private.version_of(base) if textures.numel() >= _MANY and is_plain((base,)) else None
    if version is None or not base.untyped_storage().resizable():  # torch does not count changes of an array's memory
        validate.finite("textures", textures)
        return
    state = (version, textures.data_ptr(), textures.shape, textures.stride())
    if _finite.get(base) != state:
        validate.finite("textures", textures)
        if validate.values_are_checked(textures):
            _finite[base] = state


def _checked_light(light: Tensor | None, faces: Tensor) -> Tensor:
    batch, count = faces.shape[:2]
    if light is None:
        return joined((torch.ones((), device=faces.device).expand(1, 2, count, 3),), 0)
    validate.floating("light", light, ("B", 2, count, 3))
    validate.same_device(faces=faces, light=light)
    if light.shape[0] not in (1, batch):
        raise ValueError(f"light: expected parameters for {batch} images or for all, got {light.shape[0]}")
    validate.finite("light", light)
    return light
