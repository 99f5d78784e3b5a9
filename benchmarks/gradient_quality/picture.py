"""Scenes in the form that every renderer can draw: triangles on the screen, with depth and colours at corners."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor


@dataclass(frozen=True)
class Picture:
    """Triangles on the screen, without camera, light or texture: those are torch functions before it.

    Attributes:
        vertices: [V, 3] float64: x to the right and y up in pixels from the bottom left corner of the image; depth in
            [1, 10], smaller in front and linear on the screen, as -1 / z is in perspective.
        faces: [F, 3] int64; both sides are drawn.
        colors: [F, 3, 3] float64: face, corner, channel; linear within a face on the screen.
        size: Side of the image in pixels.
        background: Colour.
    """

    vertices: Tensor
    faces: Tensor
    colors: Tensor
    size: int
    background: tuple[float, float, float] = (0.1, 0.3, 0.2)

    def moved(self, shift: Tensor) -> Picture:
        """Shift the picture by [2] pixels."""
        return replace(self, vertices=self.vertices + torch.nn.functional.pad(shift.double(), (0, 1)))

    def detached(self) -> Picture:
        """Return the picture without its autograd graph."""
        return replace(self, vertices=self.vertices.detach(), colors=self.colors.detach())
