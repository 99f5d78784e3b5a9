"""Surface of what has no outline, such as a wall or a room: depth of all photographs, fused to one mesh.

From coarse to fine: the depth of each photograph is swept around the surface so far, at first around a plane. What
photographs agree on are points with normals, which Poisson reconstruction (Kazhdan and Hoppe, "Screened Poisson surface
reconstruction", 2013, in pycolmap) makes a mesh of. Faces far from all points are trimmed.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from scipy.spatial import cKDTree
from torch import Tensor

from .....io.files import import_library
from .....meshes.mesh import Mesh
from .....rendering.forward import render
from ....common.geometry.remesh import remesh
from ....common.views.views import Views, downscale, photos_of
from ...hull import large_components
from ..copies import Progress
from .depth import (
    DepthMaps,
    choose_partners,
    compare,
    depth_of,
    depth_range,
    factors_around,
    planes,
    shift_of,
    supported,
)
from .sweep import rays_of, sweep

_LEVELS = (4, 2, 1)  # sides of the pictures of each level, as parts of the full side
_SLOPE = 2  # pixels to each side from which a normal is computed
_LEAST_CLOUD = 1000
_CELL, _MOST_DEPTH = 1.5, 10  # size of the least cell of the octree in pixels, and its most levels
_CUBE = 1.1  # cube that the octree divides, relative to the points, as in Poisson reconstruction
_REACH = 6.0  # distance from the nearest point, in pixels, beyond which no view shows the surface
_COLORS = "red", "green", "blue"
_EDGE = 4.0  # length of edges in pixels; windows do not show finer details
_PASSES = 3  # of remeshing


def find_surface(views: Views, points: Tensor, progress: Progress) -> tuple[Tensor, Tensor]:
    """Reconstruct the surface that N posed photographs show: vertices and faces, whose edges are about 4 pixels long.

    The points [P, 3] of structure from motion give the range of depth. ValueError: Photographs do not agree on a
    surface.
    """
    points = points.to(views.masks)
    known = depth_of(views, points)
    if known is None:
        raise ValueError("points: expected some in each photograph, got one that shows none")
    partners, steps = choose_partners(views, known, points), len(_LEVELS) * len(views)
    surface = _Surface(points[:0], torch.zeros(0, 3, dtype=torch.int64), points[:0, 0], [])
    for level, part in enumerate(_LEVELS):
        greys = [downscale(photo.mean(0, keepdim=True), max(views.size) // part)[0] for photo in photos_of(views)]
        found, shifts = [], []
        for row in range(len(views)):
            progress("depth", level * len(views) + row, steps)
            base, factors, shift = _hypotheses(views, row, partners[row], known[row], greys[row].shape, surface)
            found.append(sweep(views, torch.stack(greys), row, partners[row], base, factors))
            shifts.append(shift)
        surface = _poisson(_cloud(views, compare(views, found, shifts)))
    progress("depth", steps, steps)
    mesh = remesh((surface.vertices, surface.faces), _EDGE * surface.pixel, passes=_PASSES)
    return mesh.vertices, mesh.faces


@dataclass(frozen=True)
class _Surface:
    """Surface so far."""

    vertices: Tensor  # [V, 3]
    faces: Tensor  # [F, 3]
    pixel: Tensor  # [V], size of a pixel there
    depths: list[Tensor]  # depth [H, W] that each view found, NaN where others do not agree


def _hypotheses(
    views: Views, row: int, partners: list[int], known: Tensor, size: Sequence[int], surface: _Surface
) -> tuple[Tensor, Tensor, float]:
    """Choose the depths to try for a view with points at known depths, as `sweep` takes them; and their `shift_of`."""
    if not len(surface.faces):
        return planes(views, row, partners, known, (size[0], size[1]))
    base = _base(views, row, surface, (size[0], size[1]), depth_range(known))
    shift = shift_of(views, row, partners, base)
    return base, factors_around(shift), shift


def _base(views: Views, row: int, surface: _Surface, size: tuple[int, int], limits: tuple[float, float]) -> Tensor:
    """Draw the depth [H, W] of the surface so far; where there is none, the depth that the view found by itself."""
    near, far = limits[0] / 2, limits[1] * 2
    options: dict[str, Any] = {"near": near, "far": far, "anti_aliasing": False, "light": None}
    images = render(
        (surface.vertices, surface.faces), views.camera[row : row + 1], size, outputs=("depth", "alpha"), **options
    )
    known = F.interpolate(surface.depths[row][None, None], size, mode="nearest")[0, 0]
    return torch.where(images.alpha[0] > 0.5, images.depth[0], known)


@dataclass(frozen=True)
class _Cloud:
    """Points that several views agree on."""

    points: Tensor  # [P, 3]
    normals: Tensor  # [P, 3]
    pixel: Tensor  # [P], size of a pixel there
    depths: list[Tensor]  # depth [H, W] of each view; NaN where others do not agree


def _cloud(views: Views, maps: DepthMaps) -> _Cloud:
    """Make points of the depth that enough views found."""
    depths, parts = list(torch.where(supported(maps), maps.depth, torch.nan)), []
    for row, depth in enumerate(depths):
        eye, ray = rays_of(views.camera[row : row + 1], (depth.shape[0], depth.shape[1]))
        place = eye + depth[..., None] * ray
        normal = torch.linalg.cross(_difference(place, 0), _difference(place, 1))
        normal = normal * -(normal * ray).sum(-1, keepdim=True).sign()
        good = torch.isfinite(normal).all(-1) & (normal.norm(dim=-1) > 0) & torch.isfinite(depth)
        pixel = (ray[1:, 1:] - ray[:-1, :-1]).norm(dim=-1).median() / 2**0.5 * depth
        parts.append((place[good], F.normalize(normal[good], dim=1), pixel[good]))
    points, normals, pixel = (torch.cat(values) for values in zip(*parts, strict=True))
    if len(points) < _LEAST_CLOUD:
        raise ValueError(
            "photographs: expected some that agree on a surface, got none; it may shine, lack a pattern, "
            f"or need a size=PIXELS above {max(views.size)}"
        )
    return _Cloud(points, normals, pixel, depths)


def _difference(place: Tensor, axis: int) -> Tensor:
    """Compute central differences [H, W, 3] of an image of points along an axis, over some pixels to each side."""
    return place.roll(-_SLOPE, axis) - place.roll(_SLOPE, axis)


def _poisson(cloud: _Cloud) -> _Surface:
    """Make a surface of a cloud, trimmed where there are no points."""
    colmap = import_library("pycolmap", "to make a surface of points")
    extent = float((cloud.points.amax(0) - cloud.points.amin(0)).max())
    cell = _CELL * float(cloud.pixel.median())
    options = colmap.PoissonMeshingOptions()
    options.depth = int(min(max(np.ceil(np.log2(_CUBE * extent / cell)), 5), _MOST_DEPTH))
    options.num_threads = 1  # several wait for each other: thirty times as long while other programs run
    options.trim, options.color = 0.0, False
    with tempfile.TemporaryDirectory() as place:
        _write_points(Path(place) / "points.ply", cloud)
        colmap.poisson_meshing(Path(place) / "points.ply", Path(place) / "mesh.ply", options)
        mesh = Mesh.load(Path(place) / "mesh.ply", texture_size=1)
    vertices, faces = mesh.vertices, mesh.faces.long()
    distance, near = cKDTree(cloud.points.numpy()).query(vertices.numpy())
    pixel = cloud.pixel[torch.from_numpy(near)]
    kept = torch.from_numpy(distance).to(vertices) < _REACH * pixel
    columns = torch.cat((vertices, pixel[:, None]), 1)
    columns, faces = large_components(columns, faces[kept[faces].all(1)])
    return _Surface(columns[:, :3], faces, columns[:, 3], cloud.depths)


def _write_points(path: Path, cloud: _Cloud) -> None:
    """Write points with normals and, because Poisson reconstruction needs colours, black."""
    names = [*((name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")), *((c, "u1") for c in _COLORS)]
    rows = np.zeros(len(cloud.points), names)
    for (name, _), column in zip(names, torch.cat((cloud.points, cloud.normals), 1).T.numpy(), strict=False):
        rows[name] = column
    lines = [f"property {'float' if kind == '<f4' else 'uchar'} {name}" for name, kind in names]
    head = "\n".join(("ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}", *lines, "end_header\n"))
    path.write_bytes(head.encode() + rows.tobytes())
