"""Isosurface extraction by naive surface nets."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

Field = Callable[[np.ndarray], np.ndarray]  # from points [..., 3] to values [...], negative inside


def isosurface(field: Field, steps: int, half: float = 1.15) -> tuple[Tensor, Tensor]:
    """Extract the surface field = 0 in [−half, half]³ by naive surface nets on steps³ cells (Gibson, 1998).

    A cell with a sign change gets one vertex, at the mean of the crossings of its edges. A crossed edge gets a quad
    that connects the vertices of its four cells. Returns vertices [V, 3] float32 and outward faces [F, 3] int64.
    """
    n = steps + 1
    grid = np.moveaxis(np.indices((n, n, n)), 0, -1).astype(np.float64)
    values = field(grid * (2 * half / steps) - half)
    total, count = np.zeros((steps, steps, steps, 3)), np.zeros((steps, steps, steps))
    quads: list[np.ndarray] = []
    for axis in range(3):
        low, high = (np.take(values, range(i, steps + i), axis) for i in (0, 1))
        crossed = (low < 0) != (high < 0)
        where = np.take(grid, range(steps), axis)
        where[..., axis] += low / np.where(crossed, low - high, 1)
        p, q = (axis + 1) % 3, (axis + 2) % 3
        for i in (0, 1):
            for j in (0, 1):
                part: list[slice] = [slice(None)] * 3
                part[p], part[q] = slice(i, i + steps), slice(j, j + steps)
                total += where[tuple(part)] * crossed[tuple(part)][..., None]
                count += crossed[tuple(part)]
        edge = np.argwhere(crossed)
        step_p, step_q = np.eye(3, dtype=np.int64)[[p, q]]
        quad = np.stack([edge - step_p - step_q, edge - step_q, edge, edge - step_p], axis=1)
        outward = low[crossed] < 0
        quads.append(np.where(outward[:, None, None], quad, quad[:, ::-1]))
    cells = count > 0
    number = np.full(count.shape, -1)
    number[cells] = np.arange(cells.sum())
    corners = number[tuple(np.moveaxis(np.concatenate(quads), -1, 0))]
    vertices = total[cells] / count[cells][:, None] * (2 * half / steps) - half
    faces = corners[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3)
    return torch.from_numpy(vertices.astype(np.float32)), torch.from_numpy(faces)
