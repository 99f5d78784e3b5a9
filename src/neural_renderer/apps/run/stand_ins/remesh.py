"""The interface of cumesh's `remeshing`: the surface at a small distance from a mesh. An independent implementation.

Its vertices are those of surface nets on cells around the surface.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ...common.geometry.isosurface import CORNERS, surface_net
from .bvh import cuBVH

_DENSE = 32  # grids of up to this many cells a side are dense; finer cells exist only near the surface
_HALF_DIAGONAL = 0.8661  # of a cube with side 1


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
    points, quads = surface_net(cells, _values(field, cells, resolution))
    points = (points.to(vertices) / resolution - 0.5) * scale + center
    triangles = _split(points, quads)
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
            cells = (2 * cells[:, None] + cells.new_tensor(CORNERS)).reshape(-1, 3)
    return cells


def _values(field: Any, cells: Tensor, resolution: int) -> Tensor:
    """Compute the values [N, 8] at the corners of cells."""
    side = resolution + 1
    places = cells[:, None] + cells.new_tensor(CORNERS)
    keys, corners = torch.unique((places * cells.new_tensor((side**2, side, 1))).sum(-1), return_inverse=True)
    values: Tensor = field(torch.stack((keys // side**2, keys // side % side, keys % side), 1))[corners]
    return values


def _split(points: Tensor, quads: Tensor) -> Tensor:
    """Split quads [Q, 4] into triangles [2 Q, 3] at the shorter diagonal."""
    corners = points[quads]
    shorter = (corners[:, 0] - corners[:, 2]).norm(dim=1) <= (corners[:, 1] - corners[:, 3]).norm(dim=1)
    turned = torch.where(shorter[:, None], quads, quads.roll(-1, 1))
    return torch.cat((turned[:, [0, 1, 2]], turned[:, [0, 2, 3]]))
