"""Distance of two surfaces, and holes of one."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...meshes.pieces import merged_vertices
from ..common.geometry.closest_points import closest_points
from ..common.geometry.defects import border_edges, connected_borders
from ..common.geometry.sample_points import checked_surface, sample_points
from .options import CompareOptions


@torch.no_grad()
def surface_distance(first: Any, second: Any, samples: int = CompareOptions.samples) -> tuple[float, float]:
    """Measure the symmetric distance of two surfaces, by points on each and their closest points on the other.

    Args:
        first, second: `Mesh`, `UVMesh` or (vertices [V, 3], faces [F, 3]).
        samples: Number of points on each, uniform by area; always the same ones.

    Returns:
        The mean of the mean distances in both directions, and the largest distance, in world units.

    Raises:
        TypeError, ValueError: As `sample_points` and `closest_points`.

    Example:
        >>> from neural_renderer.apps.compare.surfaces import surface_distance
        >>> mean, largest = surface_distance(nr.icosphere(3), nr.icosphere(3, radius=1.5), 1000)
        >>> round(mean, 2), round(largest, 2)
        (0.5, 0.5)
    """
    generator = torch.Generator(first.vertices.device if hasattr(first, "vertices") else first[0].device)
    distances = []
    for here, there in ((first, second), (second, first)):
        points = sample_points(here, samples, generator.manual_seed(0)).points
        distances.append((closest_points(there, points).points - points).norm(dim=1))
    return float(sum(one.double().mean() for one in distances) / 2), float(max(one.max() for one in distances))


def count_holes(vertices: Tensor, faces: Tensor) -> int:
    """Count the connected borders of a surface, whose edges have one face; vertices at one place count as one.

    Args:
        vertices: [V, 3] floating.
        faces: [F, 3] integer.

    Returns:
        The number of borders: 0 for a closed surface. Two holes that share a vertex count as one.

    Raises:
        TypeError, ValueError: A type or shape does not fit, or an index is out of range.

    Example:
        >>> from neural_renderer.apps.compare.surfaces import count_holes
        >>> vertices, faces = nr.cube()
        >>> count_holes(vertices, faces), count_holes(vertices, faces[1:])
        (0, 1)
    """
    checked_surface((vertices, faces))
    corners = merged_vertices(vertices, faces, 0.0)[1].long().cpu().numpy()
    corners = corners[(corners != np.roll(corners, 1, 1)).all(1)]
    if not len(corners):
        return 0
    border = border_edges(corners)
    return connected_borders(border)[0] if len(border) else 0
