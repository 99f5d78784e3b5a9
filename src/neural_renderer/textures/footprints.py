"""Texture lookup by pixel footprints, and lookup in cube maps."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from ..raster.clip.texture_levels import BOUNDARIES, FILTERS, sample_levels
from ..raster.colors.mipmaps import level_sizes, pyramid


def sample_footprints(
    texture: Tensor,
    uv: Tensor,
    face_index: Tensor | None,
    footprint: Tensor | None,
    levels: int,
    repeats: Sequence[bool],
) -> Tensor:
    """Sample images [B or 1, h, w, C] or cube maps [B or 1, 6, h, h, C] as `sample_texture`, from valid arguments.

    ``footprint`` is [B, H, W, 2 or 3, 2] or None; ``repeats`` are for u and v of images.
    """
    uv = masked(uv, face_index)
    footprint = None if footprint is None else masked(footprint, face_index)
    if footprint is None and face_index is not None:
        footprint = _differences(uv, face_index)
    levels = 1 if footprint is None else levels
    if uv.shape[3] == 3:
        boundary = [BOUNDARIES["cube"]] * 2
    else:
        uv = torch.stack((uv[..., 0], 1 - uv[..., 1]), -1)  # row 0 at the top; the sign of a footprint does not matter
        boundary = [BOUNDARIES["wrap" if repeat else "clamp"] for repeat in repeats]
    size = [*texture.shape[-3:-1], levels]
    given = None if levels == 1 or footprint is None else footprint.flatten(3)
    result = sample_levels(
        _all_texels(texture, levels), uv, given, None, size, FILTERS["linear-mipmap-linear"], boundary
    )
    return masked(result, face_index)


def masked(values: Tensor, face_index: Tensor | None) -> Tensor:
    """Set values [B, H, W, …] of pixels without a face to 0, also where they are NaN."""
    if face_index is None:
        return values
    return torch.where(face_index.reshape(*face_index.shape, *[1] * (values.dim() - 3)) < 0, 0.0, values)


def _all_texels(texture: Tensor, levels: int) -> Tensor:
    """Make the mipmaps; return texels [B, T, C] ordered by level, then by face of a cube map."""
    flat = pyramid(texture.flatten(0, -4).movedim(3, 1), levels).unflatten(0, texture.shape[:-3])
    if texture.dim() == 4:
        return flat
    counts = [height * width for _, height, width in level_sizes(*texture.shape[2:4])[:levels]]
    return torch.cat([level.flatten(1, 2) for level in flat.split(counts, 2)], 1)


def _differences(uv: Tensor, face_index: Tensor) -> Tensor:
    """Return forward differences of uv within each face, or backward ones where there are none; else 0."""
    changes = []
    for axis in (2, 1):
        step = uv.detach().diff(dim=axis)
        same = (face_index.diff(dim=axis) == 0)[..., None]
        none = torch.zeros_like(step.narrow(axis, 0, 1)) if step.shape[axis] else torch.zeros_like(uv)
        to_next = torch.cat((torch.where(same, step, 0.0), none), axis)
        from_last = torch.cat((none, torch.where(same, step, 0.0)), axis)
        has_next = torch.cat((same, torch.zeros_like(none[..., :1], dtype=torch.bool)), axis)
        changes.append(torch.where(has_next, to_next, from_last))
    return torch.stack(changes, -1)
