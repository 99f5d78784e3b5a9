"""The visual hull: all of space that every silhouette allows. Where a fit begins, with the right holes and handles."""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from ...meshes.isosurface import isosurface
from ...meshes.topology import Topology
from .descent import SmoothDescent
from .fit_views import Views

_ROOM = 1.08  # half of the cube that is carved, of a world whose object is within [-1, 1]


def frame(views: Views) -> tuple[Tensor, float]:
    """The centre [3] and half the longest side of the box around all that the silhouettes allow.

    Raises ValueError where the silhouettes have no point in common.
    """
    eye, forward = views.eyes()
    # The point nearest to all optical axes; the ridge decides where they are parallel, in favour of the origin.
    across = torch.eye(3).to(eye) - forward[:, :, None] * forward[:, None, :]
    matrix = across.sum(0) + 1e-4 * len(views) * torch.eye(3).to(eye)
    centre = torch.linalg.solve(matrix, torch.einsum("bij,bj->i", across, eye))
    half = 0.7 * float((eye - centre).norm(dim=1).min()) if views.camera.perspective else _seen(views)
    half = max(half, 1e-6)
    for cells in (48, 64):  # the second look, at what the first one found
        grown = F.max_pool2d(views.masks[:, None], 2 * (max(views.size) // 64) + 1, 1, max(views.size) // 64)[:, 0]
        points = _grid(cells).to(eye) * half + centre
        inside = points[_occupancy(views, grown, points) > 0.5]
        if not len(inside):
            raise ValueError(
                "masks: expected silhouettes of one object that meet in space, got some that do not: "
                "the cameras or their conventions may be wrong"
            )
        low, high = inside.amin(0), inside.amax(0)
        centre, half = (low + high) / 2, float((high - low).max()) / 2 + 2 * half / cells
    return centre, half


def carve(views: Views, cells: int = 64) -> tuple[Tensor, Tensor]:
    """The visual hull of views that were `moved` to the frame: vertices float32 [V, 3], faces int64 [F, 3].

    The silhouettes, blurred by about one cell, are looked up at each of the ``cells³`` points of a grid over [-1, 1];
    the least of them, less a half, is 0 at the hull (Laurentini, "The Visual Hull Concept", 1994; Martin and Aggarwal's
    volumes of 1983). Crumbs are left out: pieces of less than a hundredth of the largest one's faces.
    """
    pixels = max(1, round(min(views.size) / cells / 2))
    soft = F.avg_pool2d(F.pad(views.masks[:, None], [pixels] * 4, mode="replicate"), 2 * pixels + 1, 1)[:, 0]

    def field(points: np.ndarray) -> np.ndarray:
        flat = torch.from_numpy(points.reshape(-1, 3).astype(np.float32)).to(soft.device)
        value = 0.5 - _occupancy(views, soft, flat).cpu().numpy().astype(np.float64)
        return np.where(np.abs(points).max(-1) >= 0.999 * _ROOM, 0.5, value.reshape(points.shape[:-1]))

    vertices, faces = isosurface(field, cells, _ROOM)
    vertices, faces = largest_pieces(vertices.to(soft.device), faces.to(soft.device))
    # Descent moves neighbours together, so that it would keep the stairs that the grid leaves on thin parts.
    return SmoothDescent(Topology.of(faces), 1.0).blur(vertices), faces


def largest_pieces(vertices: Tensor, faces: Tensor, least: float = 0.01) -> tuple[Tensor, Tensor]:
    """The pieces of a mesh with at least ``least`` times the faces of the largest."""
    label = torch.arange(len(vertices), device=faces.device)
    while True:  # the lowest index in reach, passed on from corner to corner and from label to label
        lowest = label[faces].amin(1)
        passed = label.scatter_reduce(0, faces.reshape(-1), lowest.repeat_interleave(3), "amin")
        passed = passed[passed]
        if torch.equal(passed, label):
            break
        label = passed
    piece = label[faces[:, 0]]
    count = torch.bincount(piece, minlength=len(vertices))
    faces = faces[count[piece] >= least * count.max()]
    used, corners = torch.unique(faces, return_inverse=True)
    return vertices[used], corners


def _occupancy(views: Views, masks: Tensor, points: Tensor) -> Tensor:
    """The least value [P] of the masks [N, H, W] at points [P, 3]; beyond an image's border its border goes on."""
    aspect = views.size[1] / views.size[0]
    least = torch.ones(len(points), device=points.device)
    for index in range(len(views)):
        screen = views[index : index + 1].camera(points, aspect=aspect)[0]
        place = torch.stack((screen[:, 0], -screen[:, 1]), -1)[None, None]
        value = F.grid_sample(masks[index][None, None], place, padding_mode="border", align_corners=False)[0, 0, 0]
        least = torch.minimum(least, torch.where(screen[:, 2] > 0, value, 0.0))
    return least


def _grid(cells: int) -> Tensor:
    line = torch.linspace(-1, 1, cells)
    return torch.stack(torch.meshgrid(line, line, line, indexing="ij"), -1).reshape(-1, 3)


def _seen(views: Views) -> float:
    """Half the width of what the widest orthographic view shows."""
    return float(1 / torch.as_tensor(views.camera.scale).min())
