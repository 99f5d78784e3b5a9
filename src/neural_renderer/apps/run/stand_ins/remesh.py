"""The interface of cumesh's `remeshing`: the surface at a small distance from a mesh. An independent implementation.

Its vertices are those of surface nets (Gibson, "Constrained elastic surface nets", 1998) on cells around the surface.
"""

from __future__ import annotations

import itertools
from typing import Any

import torch
from torch import Tensor

from .bvh import cuBVH

_DENSE = 32  # cells along a side from which all are looked at; finer ones only where coarser ones are near the surface
_HALF_DIAGONAL = 0.8661  # of a cube with side 1
_OFFSETS = list(itertools.product((0, 1), repeat=3))


def remesh_narrow_band_dc(
    vertices: Tensor,
    faces: Tensor,
    center: Tensor,
    scale: float,
    resolution: int,
    band: float = 1,
    project_back: float = 0,
    verbose: bool = False,
    bvh: Any = None,
) -> tuple[Tensor, Tensor]:
    """Replace a mesh by the surface at ``band`` cells from it, which is closed; a closed mesh gets one on either side.

    Args:
        vertices: [V, 3] floating.
        faces: [F, 3] integer.
        center: [3], centre of the cube that is divided into cells.
        scale: Side of the cube.
        resolution: Cells along a side.
        band: Distance from the mesh, in cells.
        project_back: Share of the way back to the mesh that vertices go in the end, in [0, 1].
        verbose: Ignored.
        bvh: A `cuBVH` of the mesh; None for a new one.

    Returns:
        Vertices [N, 3] float32, and faces [M, 3] int32 whose normals point away from the mesh.
    """
    bvh = cuBVH(vertices, faces) if bvh is None else bvh
    center, distance = center.to(vertices), band * scale / resolution

    def field(places: Tensor) -> Tensor:
        """Compute the distance from the surface at places [N, 3] in cells; negative near the mesh."""
        found: Tensor = bvh.unsigned_distance((places.float() / resolution - 0.5) * scale + center)[0]
        return (found - distance) * (resolution / scale)

    cells = _cells_near(field, resolution, center.device)
    points, quads, along = _net(field, cells, resolution)
    points = (points / resolution - 0.5) * scale + center
    triangles = _split(points, torch.where(along[:, None], quads, quads.flip(1)))
    if project_back and len(points):
        _, face, weights = bvh.unsigned_distance(points, return_uvw=True)
        closest = torch.einsum("nk,nkc->nc", weights, vertices[faces.long()][face])
        points = torch.lerp(points, closest, float(project_back))
    return points.float(), triangles.int()


def _cells_near(field: Any, resolution: int, device: torch.device) -> Tensor:
    """Find the cells [N, 3] that the surface may cross, by halving coarser ones."""
    halvings = 0
    while resolution >> halvings > _DENSE and (resolution >> halvings) % 2 == 0:
        halvings += 1
    cells = torch.cartesian_prod(*[torch.arange(resolution >> halvings, device=device)] * 3)
    for left in range(halvings, -1, -1):
        size = 1 << left
        cells = cells[field((cells + 0.5) * size).abs() <= _HALF_DIAGONAL * size]
        if left:
            cells = (2 * cells[:, None] + cells.new_tensor(_OFFSETS)).reshape(-1, 3)
    return cells


def _net(field: Any, cells: Tensor, resolution: int) -> tuple[Tensor, Tensor, Tensor]:
    """Find the surface in cells [N, 3]: points [P, 3], quads [Q, 4], and whether each faces along its edge [Q]."""
    side = resolution + 2
    corner_keys = _key(cells[:, None] + cells.new_tensor(_OFFSETS), side)
    keys, corners = torch.unique(corner_keys, return_inverse=True)
    values = field(torch.stack((keys // side**2, keys // side % side, keys % side), 1))[corners]  # [N, 8]
    total, count = torch.zeros(len(cells), 3).to(values), torch.zeros(len(cells), 1).to(values)
    for first, second in itertools.combinations(range(8), 2):
        if sum(a != b for a, b in zip(_OFFSETS[first], _OFFSETS[second], strict=True)) > 1:
            continue
        start, end = values[:, first], values[:, second]
        crossed = ((start < 0) != (end < 0))[:, None]
        share = (start / (start - end))[:, None]
        ends = [values.new_tensor(_OFFSETS[number]) for number in (first, second)]
        total += torch.where(crossed, ends[0] + share * (ends[1] - ends[0]), 0.0)
        count += crossed
    own, order = torch.sort(_key(cells, side))
    quads, along = [], []
    for axis in range(3):
        end = 4 >> axis  # number of the corner at the other end of the first corner's edge
        crossed = torch.nonzero((values[:, 0] < 0) != (values[:, end] < 0))[:, 0]
        steps = [side ** (2 - (axis + turn) % 3) for turn in (1, 2)]
        base = _key(cells[crossed], side)
        around = torch.stack((base, base - steps[0], base - steps[0] - steps[1], base - steps[1]), 1)
        place = torch.searchsorted(own, around).clamp(max=max(len(own) - 1, 0))
        whole = (own[place] == around).all(1)
        quads.append(order[place[whole]])
        along.append(values[crossed[whole], 0] < 0)
    used, numbers = torch.unique(torch.cat(quads), return_inverse=True)
    return cells[used] + total[used] / count[used].clamp(min=1), numbers, torch.cat(along)


def _split(points: Tensor, quads: Tensor) -> Tensor:
    """Split quads [Q, 4] into triangles [2 Q, 3] at the shorter diagonal."""
    corners = points[quads]
    shorter = (corners[:, 0] - corners[:, 2]).norm(dim=1) <= (corners[:, 1] - corners[:, 3]).norm(dim=1)
    turned = torch.where(shorter[:, None], quads, quads.roll(-1, 1))
    return torch.cat((turned[:, [0, 1, 2]], turned[:, [0, 2, 3]]))


def _key(places: Tensor, side: int) -> Tensor:
    """Number the points [..., 3] of a grid."""
    return (places[..., 0] * side + places[..., 1]) * side + places[..., 2]
