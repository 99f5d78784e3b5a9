"""The interface of FlexGEMM's `grid_sample_3d`: samples of a sparse volume. An independent implementation."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

__all__ = ["grid_sample_3d"]


def __getattr__(name: str) -> Any:
    raise AttributeError(f"flex_gemm: expected one of {', '.join(__all__)}, got {name}, which is not here")


def grid_sample_3d(
    feats: Tensor, coords: Tensor, shape: Sequence[int], grid: Tensor, mode: str = "trilinear"
) -> Tensor:
    """Sample a sparse volume at points. The centre of voxel (i, j, k) is at (i, j, k) + 0.5.

    Args:
        feats: [N, C] floating, features of voxels.
        coords: [N, 4] integer: number in the batch, and (i, j, k).
        shape: [B, C, W, H, D], the size of the volume.
        grid: [B, L, 3] floating, points in voxels.
        mode: "trilinear", between the voxels that there are, or "nearest".

    Returns:
        [B, L, C]; 0 where there is no voxel. Differentiable in the features.

    Raises:
        ValueError: The mode is unknown.
    """
    if mode not in ("trilinear", "nearest"):
        raise ValueError(f"mode: expected trilinear or nearest, got {mode!r}")
    sides = [int(side) for side in shape[-3:]]
    keys, order = torch.sort(_key(coords.long(), sides))
    batch = torch.arange(len(grid), device=grid.device)[:, None, None].expand(*grid.shape[:2], 1)
    if mode == "nearest":
        row, known = _rows(torch.cat((batch, grid.floor().long()), 2), keys, order, sides)
        return feats[row] * known[..., None]
    low = (grid - 0.5).floor()
    result, total = torch.zeros(()).to(feats), torch.zeros(()).to(feats)
    for corner in itertools.product((0, 1), repeat=3):
        cell = low + grid.new_tensor(corner)
        row, known = _rows(torch.cat((batch, cell.long()), 2), keys, order, sides)
        weight = ((1 - (cell + 0.5 - grid).abs()).prod(2) * known)[..., None].to(feats)
        result, total = result + weight * feats[row], total + weight
    return result / total.clamp(min=1e-12)


def _key(cells: Tensor, sides: list[int]) -> Tensor:
    """Number the cells [..., 4] of volumes: int64."""
    width, height, depth = sides
    return ((cells[..., 0] * width + cells[..., 1]) * height + cells[..., 2]) * depth + cells[..., 3]


def _rows(cells: Tensor, keys: Tensor, order: Tensor, sides: list[int]) -> tuple[Tensor, Tensor]:
    """Find the rows of cells [B, L, 4] in sorted keys, and whether they are there."""
    inside = ((cells[..., 1:] >= 0) & (cells[..., 1:] < cells.new_tensor(sides))).all(-1)
    key = _key(cells, sides)
    place = torch.searchsorted(keys, key).clamp(max=max(len(keys) - 1, 0))
    return order[place], inside & (keys[place] == key)
