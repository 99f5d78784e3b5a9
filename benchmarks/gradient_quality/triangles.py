"""Lone triangles of 1 to 256 pixels at sub-pixel places and all orientations, against closed forms."""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from .adapters import Adapter
from .picture import Picture
from .quality import Quality

SIDES = (1, 2, 4, 16, 64, 256)
# Losses on the triangle as weights on the area at (x, y), in sides from its centre, with x towards a corner.
WISHES: dict[str, Callable[[Tensor, Tensor], Tensor]] = {
    "shrink": lambda x, y: torch.ones_like(x),
    "grow": lambda x, y: -torch.ones_like(x),
    "shift": lambda x, y: x,
    "rotate": lambda x, y: x * y,
}


def triangles(side: float, count: int, size: int, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Make N equilateral triangles near the middle of the image, at evenly spread sub-pixel offsets and orientations.

    Returns:
        Corners [N, 3, 2] and centres [N, 2], in pixels from the bottom left.
    """
    # An additive recurrence by powers of the root of x⁴ = x + 1, which fills the cube evenly.
    step = 1.2207440846057596 ** -torch.arange(1.0, 4, dtype=torch.float64)
    even = (torch.arange(1.0, count + 1, dtype=torch.float64)[:, None] * step + 0.5 + 0.1 * seed) % 1
    centre, angle = size / 2 + even[:, :2], even[:, 2:] * 2 * math.pi
    angle = angle + torch.arange(3) * 2 * math.pi / 3
    arms = side / math.sqrt(3) * torch.stack((angle.cos(), angle.sin()), -1)
    return centre[:, None] + arms, centre


def area_integral(corners: Tensor, centre: Tensor, axes: Tensor, wish: str) -> Tensor:
    """Integrate a polynomial weight exactly over triangles [N, 3, 2]; differentiable."""
    # Three points of equal weight integrate quadratic functions over a triangle exactly.
    shares = corners.new_tensor([[4, 1, 1], [1, 4, 1], [1, 1, 4]]) / 6
    x, y = ((shares @ corners - centre[:, None]) @ axes).unbind(-1)
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
    return WISHES[wish](x, y).mean(1) * area


def triangle_quality(side: float, wish: str, adapter: Adapter, count: int = 256) -> Quality:
    """Rotate gradients to the corners into each triangle's frame, so that they can be averaged."""
    size = 32 * math.ceil((1.2 * side + 16) / 32)
    corners, centre = triangles(side, count, size)
    first = torch.nn.functional.normalize(corners[:, 0] - centre, dim=1)
    axes = torch.stack((first, torch.stack((-first[:, 1], first[:, 0]), -1)), -1)  # [N, 2, 2], columns
    leaf = corners.clone().requires_grad_()
    (truth,) = torch.autograd.grad(area_integral(leaf, centre, axes / side, wish).sum(), leaf)
    pixel = torch.arange(size, dtype=torch.float64) + 0.5
    places = torch.stack(torch.broadcast_tensors(pixel[None, :], pixel.flip(0)[:, None]), -1)
    faces, depth = torch.arange(3)[None], torch.full((3, 1), 2.0, dtype=torch.float64)
    found = []
    for corner, middle, frame in zip(corners, centre, axes, strict=True):
        weight = WISHES[wish](*(((places - middle) / side) @ frame).unbind(-1))
        picture = Picture(torch.cat((corner, depth), 1), faces, torch.ones(1, 3, 3).double(), size, (0.0, 0.0, 0.0))
        _, moved, _ = adapter.draw(picture, torch.cat((weight[None], torch.zeros(2, size, size).double())))
        found.append(moved[:, :2].double())
    return Quality.of((torch.stack(found) @ axes).flatten(1), (truth @ axes).flatten(1))
