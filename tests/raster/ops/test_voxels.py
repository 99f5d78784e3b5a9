"""The kernels of voxelisation: a slow reference of the published evaluation, floods, winding numbers."""

from __future__ import annotations

import itertools
import math
from collections import deque

import numpy as np
import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps.reconstruct.data.inside import inside
from neural_renderer.raster.ops import voxels
from neural_renderer.raster.ops.voxels import fill


def reference(points: np.ndarray, faces: np.ndarray, size: int) -> np.ndarray:
    """Voxelise like the published evaluation, in float64; points are in voxel coordinates."""
    state = np.zeros((size,) * 3, dtype=int)

    def mark(cell: list[int]) -> None:
        if all(0 <= c < size for c in cell):
            state[tuple(cell)] = 1

    for corners in points[faces].astype(np.float64):
        for corner in corners:
            mark([math.floor(c) for c in corner])
        for axis in range(3):
            p, q = (axis + 1) % 3, (axis + 2) % 3
            flat = corners[:, [p, q]]
            matrix = np.vstack([flat.T, np.ones(3)])
            if abs(np.linalg.det(matrix)) < 1e-12:
                continue
            for line in itertools.product(range(size + 1), repeat=2):
                weights = np.linalg.solve(matrix, [*line, 1.0])
                if weights.min() < -1e-9:
                    continue
                along = math.floor(weights @ corners[:, axis] + 1e-9)
                for dp, dq in itertools.product((0, 1), repeat=2):
                    cell = [0, 0, 0]
                    cell[axis], cell[p], cell[q] = along, line[0] - dp, line[1] - dq
                    mark(cell)
    queue = deque(c for c in itertools.product(range(size), repeat=3) if {0, size - 1} & set(c) and not state[c])
    for cell in queue:
        state[cell] = 2
    while queue:
        cell = queue.popleft()
        for axis, step in itertools.product(range(3), (-1, 1)):
            beside = tuple(c + step * (k == axis) for k, c in enumerate(cell))
            if all(0 <= c < size for c in beside) and state[beside] == 0:
                state[beside] = 2
                queue.append(beside)
    return state != 2


@pytest.mark.parametrize("seed", range(4))
def test_the_published_rule(seed: int) -> None:
    generator = torch.Generator().manual_seed(seed)
    vertices, faces = nr.icosphere(0)
    bumpy = vertices * (0.5 + 0.9 * torch.rand(len(vertices), 1, generator=generator))
    points = bumpy * torch.tensor([3.1, 2.3, 4.2]) + 3.53  # some of it outside of the grid
    expected = reference(points.numpy(), faces.numpy(), 7)
    assert np.array_equal(fill(points[None], faces.int(), 7)[0].numpy(), expected)


def test_a_corner_without_a_place_marks_nothing(device: str) -> None:
    """The conversion of NaN to an integer differs between devices: 0 on CUDA."""
    vertices = torch.tensor([[5.0, 5, 5], [6, 5, 5], [5, 6, 5], [math.nan] * 3, [math.inf] * 3])
    faces = torch.tensor([[0, 1, 2], [0, 1, 3], [0, 2, 4]], dtype=torch.int32)
    filled = fill(vertices[None].to(device), faces.to(device), 8)
    alone = fill(vertices[None, :3].to(device), faces[:1].to(device), 8)
    assert torch.equal(filled, alone)


@pytest.mark.parametrize("share", [0.3, 0.55, 0.7])
def test_lines_flood_the_same_as_sweeps(share: float) -> None:
    """CUDA floods line by line. Where half of the voxels are full at random, the empty ones make mazes."""
    full = torch.rand(3, 14, 14, 14, generator=torch.Generator().manual_seed(0)) < share
    by_sweeps, by_lines = full.to(torch.uint8), full.to(torch.uint8)
    voxels.launch(voxels._flood, len(full), [voxels._Grids(state=by_sweeps, size=14)], full.device)
    voxels._flood_by_lines(by_lines)
    assert torch.equal(by_sweeps, by_lines) and {0, 1, 2} >= set(by_lines.unique().tolist()) >= {1, 2}


def test_winding_numbers() -> None:
    vertices, faces = nr.icosphere(3)
    points = torch.tensor([[0.0, 0, 0], [0.9, 0, 0], [1.1, 0, 0], [0, -3, 0]])
    assert inside(vertices, faces.int(), points).tolist() == [True, True, False, False]
