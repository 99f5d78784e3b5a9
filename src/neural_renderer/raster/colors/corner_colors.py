"""Colours at the corners of faces, for the gradient through visibility where faces interpolate them."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from .texture_cubes import lit_corners


@dataclass(frozen=True, eq=False)
class CornerColors:
    """Colours of corners [1 or B, F, 3, 3], or cubes of one texel, under light [1 or B, 2, F, 3], if there is light.

    ``firsts`` as in `sample_textures`; then there is light, too.
    """

    colors: Tensor
    light: Tensor | None
    firsts: Tensor | None = None

    def __call__(self, corners: Tensor, perspective: bool) -> Tensor:
        """Light the colours on the visible sides of faces with screen-space corners [B, F, 3, 3]: [1 or B, F, 3, 3]."""
        colors = self.colors.detach().float()
        if self.light is None:
            return colors if colors.dim() == 4 else colors[:, :, 0, 0].expand(-1, -1, 3, -1)
        return lit_corners(colors.contiguous(), self.light.detach(), corners.contiguous(), perspective, self.firsts)
