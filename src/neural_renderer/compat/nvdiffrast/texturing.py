"""`texture`: filtered samples of images and cube maps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ...base import validate
from ...base.one_line import OneLine
from ...raster.clip.texture_levels import BOUNDARIES, FILTERS, halve_levels, level_sizes, sample_levels
from . import checks


@dataclass(frozen=True, eq=False, repr=False)
class MipStack(OneLine):
    """The mipmaps of a texture, as from `texture_construct_mip`."""

    texels: Tensor  # as from `halve_levels`
    count: int  # of levels
    shape: torch.Size  # of the texture
    cube_mode: bool


@validate.checked_together
def texture(
    tex: Tensor,
    uv: Tensor,
    uv_da: Tensor | None = None,
    mip_level_bias: Tensor | None = None,
    mip: MipStack | Sequence[Tensor] | None = None,
    filter_mode: str = "auto",
    boundary_mode: str = "wrap",
    max_mip_level: int | None = None,
) -> Tensor:
    """Sample a texture at coordinates of pixels.

    The level of detail is log2 of the texels along the longer axis of the ellipse that a pixel covers in the texture,
    the larger singular value of the derivatives in ``uv_da``; "linear-mipmap-linear" blends the two levels around it,
    and "linear-mipmap-nearest" takes the larger of them. Gradients reach ``tex`` or the tensors of ``mip``, ``uv``,
    ``uv_da`` and ``mip_level_bias``.

    Args:
        tex: [B or 1, h, w, C] float32; a cube map [B or 1, 6, h, h, C], its faces +x, −x, +y, −y, +z, −z in OpenGL's
            orientation. The first texel in memory lies at (0, 0).
        uv: Coordinates [B, H, W, 2] float32, [0, 1] over the texture; for a cube map directions [B, H, W, 3].
        uv_da: Screen-space derivatives of ``uv``, as from `interpolate`, [B, H, W, 4 or 6].
        mip_level_bias: Added to the level, [B, H, W] float32; without ``uv_da`` it is the level.
        mip: Smaller levels: the result of `texture_construct_mip`, or tensors of its sizes. None: computed here.
        filter_mode: "nearest", "linear", "linear-mipmap-nearest" or "linear-mipmap-linear". "auto" is the last one with
            ``uv_da`` or ``mip_level_bias``, else "linear".
        boundary_mode: "wrap", "clamp", "zero", or "cube" for cube maps. Samples of these run across edges of the faces.
        max_mip_level: Most levels above the texture itself. None goes on to 1 x 1 texel.

    Returns:
        [B, H, W, C] float32; 0 for a direction of length 0.

    Raises:
        TypeError, ValueError: An argument of another type, shape, device or name; a side that cannot be halved.

    Example:
        >>> import neural_renderer.nvdiffrast as dr
        >>> uv = torch.rand(1, 64, 64, 2)
        >>> footprint = torch.full((1, 64, 64, 4), 0.05)
        >>> dr.texture(torch.rand(1, 32, 32, 3), uv, footprint).shape
        torch.Size([1, 64, 64, 3])
    """
    if boundary_mode not in BOUNDARIES:
        raise ValueError(f"boundary_mode: expected one of {', '.join(BOUNDARIES)}, got {boundary_mode!r}")
    cube = boundary_mode == "cube"
    _checked_texture("tex", tex, cube)
    checks.float32("uv", uv, ("B", "H", "W", 3 if cube else 2))
    checks.batch_like("tex", tex, len(uv), "uv")
    if uv_da is not None:
        checks.float32("uv_da", uv_da, (*uv.shape[:3], 2 * uv.shape[3]))
    if mip_level_bias is not None:
        checks.float32("mip_level_bias", mip_level_bias, tuple(uv.shape[:3]))
    validate.same_device(tex=tex, uv=uv, uv_da=uv_da, mip_level_bias=mip_level_bias)
    chosen = uv_da is not None or mip_level_bias is not None
    if filter_mode == "auto":
        filter_mode = "linear-mipmap-linear" if chosen else "linear"
    if filter_mode not in FILTERS:
        raise ValueError(f"filter_mode: expected 'auto' or one of {', '.join(FILTERS)}, got {filter_mode!r}")
    max_mip_level = _checked_limit(max_mip_level)
    texels, count = tex, 1
    if "mipmap" in filter_mode:
        if not chosen:
            raise ValueError(f"filter_mode: expected uv_da or mip_level_bias for {filter_mode!r}, got neither")
        texels, count = _all_texels(tex, mip, max_mip_level, cube)
    if count == 1:
        texels, uv_da = tex.flatten(1, -2), None
    size = [*tex.shape[-3:-1], count]
    filtering, boundary = FILTERS[filter_mode], [BOUNDARIES[boundary_mode]] * 2
    return sample_levels(texels, uv, uv_da, mip_level_bias, size, filtering, boundary)


@validate.checked_together
def texture_construct_mip(tex: Tensor, max_mip_level: int | None = None, cube_mode: bool = False) -> MipStack:
    """Compute the mipmaps of a texture once for several calls of `texture`.

    Args:
        tex: As in `texture`.
        max_mip_level: As in `texture`.
        cube_mode: Whether ``tex`` is a cube map.

    Returns:
        An object for the argument ``mip`` of `texture`.

    Raises:
        TypeError, ValueError: As in `texture`.

    Example:
        >>> import neural_renderer.nvdiffrast as dr
        >>> tex = torch.rand(1, 32, 32, 3)
        >>> mip = dr.texture_construct_mip(tex)
        >>> dr.texture(tex, torch.rand(1, 64, 64, 2), torch.rand(1, 64, 64, 4), mip=mip).shape
        torch.Size([1, 64, 64, 3])
    """
    _checked_texture("tex", tex, validate.flag("cube_mode", cube_mode))
    count = _count_levels(tex, _checked_limit(max_mip_level))
    return MipStack(_halved(tex.detach(), count), count, tex.shape, cube_mode)


def _checked_limit(max_mip_level: Any) -> int | None:
    return None if max_mip_level is None else validate.whole("max_mip_level", max_mip_level, 0)


def _checked_texture(name: str, tex: Any, cube: bool) -> None:
    checks.float32(name, tex, ("B", 6, "h", "w", "C") if cube else ("B", "h", "w", "C"))
    if 0 in tex.shape:
        raise ValueError(f"{name}: expected at least one texel and channel, got {validate.shape_of(tex)}")
    if cube and tex.shape[2] != tex.shape[3]:
        raise ValueError(f"{name}: expected square faces of a cube map, got {validate.shape_of(tex)}")


def _count_levels(tex: Tensor, max_mip_level: int | None) -> int:
    """Count the levels of a texture, its own included; raise where a side cannot be halved."""
    height, width = tex.shape[-3:-1]
    count = max(height, width).bit_length()
    if max_mip_level is not None:
        count = min(count, 1 + max_mip_level)
    for level, (rows, columns) in enumerate(level_sizes(height, width, count - 1)):
        if any(side > 1 and side % 2 for side in (rows, columns)):
            raise ValueError(
                f"tex: expected sides that can be halved to 1, got {rows} x {columns} at level {level}; "
                f"max_mip_level={level} stops there"
            )
    return count


def _halved(tex: Tensor, count: int) -> Tensor:
    """Compute the texels of all levels of a texture."""
    return halve_levels(tex if tex.dim() == 5 else tex[:, None], count) if count > 1 else tex.flatten(1, -2)


def _all_texels(tex: Tensor, mip: Any, max_mip_level: int | None, cube: bool) -> tuple[Tensor, int]:
    """Return the texels of all levels for a call, and the number of levels."""
    if mip is None:
        count = _count_levels(tex, max_mip_level)
        return _halved(tex, count), count
    if isinstance(mip, MipStack):
        if mip.cube_mode != cube:
            raise ValueError(f"mip: expected mipmaps made with cube_mode={cube}, got cube_mode={mip.cube_mode}")
        if mip.shape != tex.shape:
            raise ValueError(f"mip: expected mipmaps of tex {list(tex.shape)}, got those of {list(mip.shape)}")
        count = mip.count if max_mip_level is None else min(mip.count, 1 + max_mip_level)
        # The object holds no graph, so that it can be used in several steps with a texture that requires gradients.
        if tex.requires_grad and torch.is_grad_enabled():
            return _halved(tex, count), count
        base = tex.flatten(1, -2)
        height, width = tex.shape[-3:-1]
        total = base.shape[1] // (height * width) * sum(h * w for h, w in level_sizes(height, width, count))
        return torch.cat((base, mip.texels[:, base.shape[1] : total]), 1), count
    if not isinstance(mip, Sequence):
        expected = "the result of texture_construct_mip or a list of tensors"
        raise TypeError(f"mip: expected {expected}, got {type(mip).__name__}")
    levels = list(mip)[:max_mip_level]
    *batch, height, width, channels = tex.shape
    for n, level in enumerate(levels):
        if any(side > 1 and side % 2 for side in (height, width)) or max(height, width) == 1:
            raise ValueError(f"mip: expected at most {n} levels after sides that cannot be halved, got {len(levels)}")
        height, width = max(1, height // 2), max(1, width // 2)
        checks.float32(f"mip[{n}]", level, (*batch, height, width, channels))
    return torch.cat([level.flatten(1, -2) for level in (tex, *levels)], 1), 1 + len(levels)
