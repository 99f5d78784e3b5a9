"""Gradients of a case and its central differences, both means over sub-pixel shifts, with their noise."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import torch
from torch import Tensor

import neural_renderer as nr

from .cases import FAR, Case

OUTPUTS = ("rgb", "alpha", "depth", "normal", "uv", "position")
Draw = Callable[[Tensor, nr.Camera, int], Tensor]  # vertices, cameras and a size to images [B, C, size, size]


@dataclass(frozen=True)
class Cell:
    """A gradient along the motions of a case, compared with differences.

    Attributes:
        ratio: Length of the gradient along the differences, relative to theirs; 1 is right.
        noise: Standard error of the ratio.
        cosine: Between gradient and differences, over the motions of the case.
        spread: Expected length of the error across the differences by noise alone, relative to them.
        shifts: Number of sub-pixel shifts.
    """

    ratio: float
    noise: float
    cosine: float
    spread: float
    shifts: int

    @classmethod
    def of(cls, samples: Tensor, differences: Tensor, shifts: int) -> Cell:
        """Compare means of groups of shifts, [G, K], with differences at several grids, [M, K]; float64."""
        truth, found = differences.mean(0), samples.mean(0)
        length = truth.norm()
        if length == 0:
            return cls(math.nan, 0.0, math.nan, 0.0, shifts)
        spread = variance = 0.0
        for rows in (samples, differences):
            if len(rows) > 1:
                along = rows @ truth / length**2
                variance += float(along.var() / len(rows))
                off = rows - along[:, None] * truth
                spread += float((off - off.mean(0)).square().sum() / (len(rows) - 1) / len(rows) / length**2)
        cosine = torch.cosine_similarity(found, truth, dim=0)
        return cls(float(found @ truth / length**2), variance**0.5, float(cosine), spread**0.5, shifts)

    def fails(self, bound: float = 0.02, turn: float = 0.1, size: float = 1.0) -> bool:
        """Test whether the ratio is off ``size``, or the direction, by more than thrice the noise and a bound."""
        wrong_size = abs(self.ratio - size) > max(3 * self.noise, bound)
        return wrong_size or self.turn > max(3 * self.spread, turn)

    @property
    def turn(self) -> float:
        """Sine of the angle between the gradient and the differences."""
        return max(1 - self.cosine**2, 0.0) ** 0.5

    def row(self) -> dict[str, Any]:
        """Return the attributes for a file."""
        return asdict(self)


def drawing(case: Case, output: str, gradient: Any = "edge", anti_aliasing: bool = False) -> Draw:
    """Make the function that draws an output of a case for given vertices."""
    options = {"light": None, "outputs": (output,), "far": FAR, "gradient": gradient, "anti_aliasing": anti_aliasing}

    def draw(vertices: Tensor, camera: nr.Camera, size: int) -> Tensor:
        image = getattr(nr.render(case.mesh.replace(vertices=vertices), camera, size, **options), output)
        return image if image.dim() == 4 else image[:, None]

    return draw


def weights(channels: int, size: int) -> Tensor:
    """Make weights [C, size, size] float64 of the loss Σ weight · image, which vary over the image as slow waves."""
    generator = torch.Generator().manual_seed(7)
    place = (torch.arange(size, dtype=torch.float64) + 0.5) / size
    result = torch.zeros(channels, size, size, dtype=torch.float64)
    for channel in result:
        for _ in range(3):
            x, y, phase = (4 * torch.rand(3, generator=generator, dtype=torch.float64) - 2).tolist()
            channel += (x * 2 * place + y * 2 * place[:, None] + 3 * phase).cos()
    return result


@torch.no_grad()
def differences(case: Case, draw: Draw, fine: int, grids: int) -> Tensor:
    """Compute central differences [grids, K] of the mean loss over fine² shifts, at several grids of shifts."""
    camera, rows = case.camera(), []
    for offset in _offsets(grids, 11):
        shifted = camera.shifted(((offset - 0.5) / fine).float(), case.size)
        slopes = []
        for motion in case.motions:
            ends = []
            for sign in (1, -1):
                image = draw(case.mesh.vertices + sign * case.step * motion, shifted, case.size * fine)[0]
                pull = weights(len(image), case.size)
                blocks = image.double().unflatten(2, (case.size, fine)).unflatten(1, (case.size, fine)).mean((2, 4))
                ends.append((blocks * pull).sum())
            slopes.append((ends[0] - ends[1]) / (2 * case.step))
        rows.append(torch.stack(slopes))
    return torch.stack(rows)


def backward(case: Case, draw: Draw, side: int, groups: int) -> Tensor:
    """Compute gradients along the motions, [groups, K], each the mean over side² shifts."""
    rows = []
    for cameras in _shifted(case, side, groups):
        total = torch.zeros(len(case.motions), dtype=torch.float64)
        for camera in cameras:
            vertices = case.mesh.vertices.clone().requires_grad_()
            image = draw(vertices, camera, case.size)
            loss = (image * weights(image.shape[1], case.size).float()).sum()
            (gradient,) = torch.autograd.grad(loss, vertices)
            total += (case.motions.double() * gradient.double()).sum((1, 2))
        rows.append(total / side**2)
    return torch.stack(rows)


def forward(case: Case, draw: Draw, side: int, groups: int) -> Tensor:
    """Compute the same in forward mode."""

    def change(motion: Tensor, camera: nr.Camera) -> Tensor:
        return torch.func.jvp(partial(draw, camera=camera, size=case.size), (case.mesh.vertices,), (motion,))[1]

    rows = []
    for cameras in _shifted(case, side, groups):
        total = torch.zeros(len(case.motions), dtype=torch.float64)
        for camera in cameras:
            changes = torch.vmap(partial(change, camera=camera))(case.motions)  # [K, B, C, size, size]
            total += (changes.double() * weights(changes.shape[2], case.size)).sum((1, 2, 3, 4))
        rows.append(total / side**2)
    return torch.stack(rows)


def _shifted(case: Case, side: int, groups: int) -> list[list[nr.Camera]]:
    """Make cameras for each group: a jittered grid of side² shifts, in batches of at most 64."""
    cells = torch.cartesian_prod(torch.arange(float(side)), torch.arange(float(side)))
    generator = torch.Generator().manual_seed(13)
    result = []
    for _ in range(groups):
        shifts = (cells + torch.rand(len(cells), 2, generator=generator)) / side - 0.5
        result.append([case.camera()[[0] * len(part)].shifted(part, case.size) for part in shifts.split(64)])
    return result


def _offsets(count: int, seed: int) -> Tensor:
    return torch.rand(count, 2, generator=torch.Generator().manual_seed(seed))
