"""Colours at the corners of faces, for the gradient through visibility where faces interpolate them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import torch
from torch import Tensor

from ..warp.elementwise import without_threads


@dataclass(frozen=True, eq=False)
class CornerColors:
    """Colours of corners [1 or B, F, 3, 3] under light [1 or B, 2, F, 3] on the front and the back of each face."""

    colors: Tensor
    light: Tensor | None

    def __call__(self, corners: Tensor, perspective: bool) -> Tensor:
        """Multiply the colours by the light on the visible sides of faces with screen-space corners [B, F, 3, 3]."""
        colors = self.colors.detach().float()
        if self.light is None:
            return colors
        return without_threads(partial(_lit, perspective), colors, self.light, corners)


def _lit(perspective: bool, module: Any, colors: Any, light: Any, corners: Any) -> Any:
    x, y, depth = (corners[..., n] for n in range(3))
    to_q, to_r = (x[..., 1] - x[..., 0], y[..., 1] - y[..., 0]), (x[..., 2] - x[..., 0], y[..., 2] - y[..., 0])
    shows_back = to_q[0] * to_r[1] - to_q[1] * to_r[0] < 0
    if perspective:  # each corner behind the camera reverses the orientation
        is_behind = depth <= 0
        shows_back = shows_back ^ is_behind[..., 0] ^ is_behind[..., 1] ^ is_behind[..., 2]
    own = module.where(shows_back[..., None], light[:, 1], light[:, 0])
    return colors * own[:, :, None]


def corner_colors(textures: Tensor, light: Tensor | None, firsts: Tensor | None, faces: int) -> CornerColors | None:
    """Return the colours of corners [1 or B, F, 3, 3], or of cubes of one texel; None for larger cubes.

    ``firsts`` as in `PackedCubes`; then the result has the given number of ``faces`` for each mesh.
    """
    if textures.dim() > 4 and textures.shape[2] > 1:
        return None
    colors = textures if textures.dim() == 4 else textures[:, :, 0, 0].expand(-1, -1, 3, -1)
    if firsts is not None:  # rows past a mesh's own belong to padding, which is never visible
        rows = firsts[:-1, None].long() + torch.arange(faces, device=colors.device)
        colors = colors[0, rows.clamp(max=colors.shape[1] - 1)]
    return CornerColors(colors, light)
