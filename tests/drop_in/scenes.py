"""Small random scenes in clip space."""

from __future__ import annotations

import torch
from torch import Tensor

import neural_renderer.nvdiffrast as dr

CONTEXT = dr.RasterizeCudaContext()


def soup(seed: int, batch: int = 2, count: int = 6, behind: bool = False) -> tuple[Tensor, Tensor]:
    """Triangles that share no vertex, in perspective: positions [B, V, 4] and triangles [F, 3].

    With ``behind``, some corners lie behind the camera, or before the near plane, or beyond the far one.
    """
    random = torch.Generator().manual_seed(seed)
    w = 0.5 + 3 * torch.rand(batch, 3 * count, 1, generator=random)
    if behind:
        w = w - 1.2
    xy = (torch.rand(batch, 3 * count, 2, generator=random) * 3 - 1.5) * w.abs()
    near, far = 0.3, 3.0
    z = (far + near) / (far - near) * w - 2 * far * near / (far - near)
    triangles = torch.arange(3 * count, dtype=torch.int32).view(-1, 3)
    return torch.cat((xy, z, w), 2), triangles


def fan(seed: int, batch: int = 1) -> tuple[Tensor, Tensor]:
    """Two strips of triangles that share vertices, one before the other: folds, borders and continuing surface."""
    random = torch.Generator().manual_seed(seed)
    w = 1 + 0.5 * torch.rand(batch, 8, 1, generator=random)
    w[:, 4:] += 1
    xy = (torch.rand(batch, 8, 2, generator=random) * 2 - 1) * w
    position = torch.cat((xy, w - 1.5, w), 2)
    one = torch.tensor([[0, 1, 2], [1, 3, 2], [0, 2, 3]], dtype=torch.int32)
    return position, torch.cat((one, one + 4))
