"""Visual hull of silhouettes on a grid: the bounds of an object, and the initial shape of a fit."""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from ...meshes.bounds import bounding_box
from ...meshes.topology import Topology
from ..common.geometry.edges import connected_components
from ..common.geometry.isosurface import isosurface
from ..common.views.views import VIEWS_PER_PASS, Views, mask_values, view_center
from .descent import smooth_once

_HALF = 1.08  # half the side of the carved cube; the object lies in [-1, 1]³
_POINTS = 64  # grid points along each axis, in each of two passes that find the object
_AT_BORDER = 0.999  # a point farther out than this share of half a cube's side is at the border
_DOUBLINGS = 3  # most doublings of a given region that the object leaves
_LEAST_COMPONENT = 0.01  # least faces of a component, relative to the largest one; smaller ones are noise
LEVELS = (64, 96, 128)  # cells along each axis; the finest has 2 million points
_LEAST_COVERED = 2.0  # least covered pixels that count in a view, in units of the squared radius of the coarsest blur
_LEAST_VIEWS = 2  # views that must show a hole
_MOST_LEFT = 0.5  # share of the covered pixels that a finer level may leave at most


def object_bounds(views: Views, misses: int = 0) -> tuple[Tensor, float]:
    """Find the object: the box around the visual hull of all silhouettes.

    Args:
        views: Views of the object.
        misses: As in `carve`.

    Returns:
        The centre [3] of the box and half its longest side, in world space.

    Raises:
        ValueError: The silhouettes have no point in common.

    Example:
        >>> eyes = nr.get_points_from_angles(3.0, 20.0, torch.arange(6) * 60.0)
        >>> views = Views.of(nr.Mesh.icosphere(2), nr.Camera.look_at(eyes, viewing_angle=25), size=32)
        >>> center, half = object_bounds(views)
        >>> 0.9 < half < 1.2
        True
    """
    center, half = views.region or view_center(views)
    margin = max(views.size) // _POINTS  # thin parts must not fall between grid points
    grown = F.max_pool2d(views.masks[:, None], 2 * margin + 1, 1, margin)[:, 0]
    wider = 0 if views.region is None else _DOUBLINGS
    for _ in range(2):
        while True:
            points = _grid(_POINTS).to(grown) * half + center
            inside = points[_occupancy(views, grown, points, misses) > 0.5]
            if not wider or not _reaches_border(inside, center, half):
                break
            half, wider = 2 * half, wider - 1  # the object was larger than the region
        if not len(inside):
            raise ValueError(
                "masks: expected silhouettes of one object that meet in space, got some that do not: "
                "the cameras or their conventions may be wrong"
            )
        center, found = bounding_box(inside)
        half = found + 2 * half / _POINTS
    return center, half


def _reaches_border(points: Tensor, center: Tensor, half: float) -> bool:
    """Return whether points [P, 3] reach the border of a cube, or there are none."""
    return not len(points) or float((points - center).abs().max()) > _AT_BORDER * half


def carve(views: Views, cells: int = LEVELS[0], misses: int = 0) -> tuple[Tensor, Tensor]:
    """Reconstruct the visual hull by space carving.

    Each point of a grid projects into all silhouettes, which are blurred by about one cell. The least value is the
    occupancy of the point, and the hull is the isosurface at 0.5 (Martin and Aggarwal, 1983; Laurentini, "The Visual
    Hull Concept", 1994). Small components are dropped.

    Args:
        views: Views that are `Views.normalized` to the object's bounds.
        cells: Number of grid cells along each axis.
        misses: Number of masks that may miss a point of the hull, for inexact cameras; less than the number of
            views.

    Returns:
        Vertices [V, 3] float32 and faces [F, 3] int64.

    Raises:
        ValueError: No point of the grid lies inside all silhouettes.

    Example:
        >>> eyes = nr.get_points_from_angles(3.0, 20.0, torch.arange(6) * 60.0)
        >>> views = Views.of(nr.Mesh.icosphere(2), nr.Camera.look_at(eyes, viewing_angle=25), size=32)
        >>> vertices, faces = carve(views, cells=16)
        >>> vertices.abs().max() < 1.2
        tensor(True)
    """
    pixels = blur_radius(views, cells)
    soft = F.avg_pool2d(F.pad(views.masks[:, None], [pixels] * 4, mode="replicate"), 2 * pixels + 1, 1)[:, 0]

    def field(points: np.ndarray) -> np.ndarray:
        flat = torch.from_numpy(points.reshape(-1, 3).astype(np.float32)).to(soft.device)
        value = 0.5 - _occupancy(views, soft, flat, misses).cpu().numpy().astype(np.float64)
        border = np.abs(points).max(-1) >= _AT_BORDER * _HALF
        return np.where(border, 0.5, value.reshape(points.shape[:-1]))  # closes the surface at the border

    vertices, faces = isosurface(field, cells, _HALF)
    if not len(faces):
        raise ValueError("views: expected silhouettes that meet in [-1, 1]³, got some that do not")
    vertices, faces = large_components(*_without_cavities(vertices.to(soft.device), faces.to(soft.device)))
    # The grid leaves staircase artefacts on thin parts. Descent keeps them, as it moves adjacent vertices together.
    return smooth_once(vertices, Topology.of(faces).edges, 1.0), faces


def blur_radius(views: Views, cells: int) -> int:
    """Return the radius in pixels by which `carve` blurs masks: about half a cell."""
    return max(1, round(min(views.size) / cells / 2))


def large_components(vertices: Tensor, faces: Tensor) -> tuple[Tensor, Tensor]:
    """Drop the connected components of a mesh with far fewer faces than the largest one."""
    component = connected_components(faces)
    count = torch.bincount(component)
    faces = faces[count[component] >= _LEAST_COMPONENT * count.max()]
    used, corners = torch.unique(faces, return_inverse=True)
    return vertices[used], corners


def _without_cavities(vertices: Tensor, faces: Tensor) -> tuple[Tensor, Tensor]:
    """Drop cavities, which silhouettes cannot show: the grid makes them in holes that are narrower than its cells."""
    component = connected_components(faces)
    corners = vertices[faces].double()
    volume = (corners[:, 0] * torch.linalg.cross(corners[:, 1], corners[:, 2])).sum(1)
    total = volume.new_zeros(len(vertices)).index_add_(0, component, volume)
    return vertices, faces[total[component] > 0]


def _occupancy(views: Views, masks: Tensor, points: Tensor, misses: int) -> Tensor:
    """Look up points [P, 3] in all masks [N, H, W], clamped at the border.

    Returns the least value [P] over the masks, without the ``misses`` lowest.
    """
    found = points.new_zeros(len(points))
    rows = torch.arange(len(points), device=points.device)  # points that are not outside yet; most soon are
    least = points.new_ones(misses + 1, len(points))  # lowest values, in ascending order
    for index in range(len(views)):
        for value in mask_values(views[index : index + 1], masks[index : index + 1], points[rows]):
            for place in range(misses + 1):
                least[place], value = torch.minimum(least[place], value), torch.maximum(least[place], value)
        inside = least[misses] > 0
        rows, least = rows[inside], least[:, inside]
    found[rows] = least[misses]
    return found


def _grid(cells: int) -> Tensor:
    """Make a grid of points over [-1, 1]³, [cells³, 3]."""
    line = torch.linspace(-1, 1, cells)
    return torch.stack(torch.meshgrid(line, line, line, indexing="ij"), -1).reshape(-1, 3)


def carve_levels(views: Views, levels: tuple[int, ...] = LEVELS) -> tuple[Tensor, Tensor]:
    """Carve the visual hull on the coarsest grid that opens the holes and gaps of the masks; as `carve`.

    A hull lies inside all silhouettes. Where it covers background deeper than its blurred border is wide, its grid is
    too coarse. If several views show that, the hull is carved again at the next of the ``levels``, grid cells along
    each axis, which is kept if it covers at most half as much.
    """
    margin = blur_radius(views, levels[0])
    shape = carve(views, levels[0])
    covered = covered_background(views, shape, margin)
    for cells in levels[1:]:
        counts = covered > _LEAST_COVERED * margin**2
        if int(counts.sum()) < min(_LEAST_VIEWS, len(views)):
            break
        finer = carve(views, cells)
        left = covered_background(views, finer, margin)
        if float(left.sum()) > _MOST_LEFT * float(covered.sum()):
            break
        shape, covered = finer, left
    return shape


@torch.no_grad()
def covered_background(views: Views, shape: tuple[Tensor, Tensor], margin: int) -> Tensor:
    """Count the background pixels that a mesh covers in each of N views, [N] int64.

    Pixels nearer to the mesh's outline than ``margin`` are left out.
    """
    found = []
    for start in range(0, len(views), VIEWS_PER_PASS):
        part = views[start : start + VIEWS_PER_PASS]
        outside = (part.draw(shape).alpha < 0.5).float()
        outside = F.max_pool2d(outside[:, None], 2 * margin + 1, 1, margin)[:, 0] > 0.5
        found.append((~outside & (part.masks < 0.5)).sum((1, 2)))
    return torch.cat(found)
