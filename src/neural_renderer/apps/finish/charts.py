"""Charts of a small mesh: by xatlas, or for many faces by the directions of their normals."""

from __future__ import annotations

import math

import numpy as np
import torch
from scipy import sparse
from scipy.sparse import csgraph
from torch import Tensor
from torch.nn import functional

from ...meshes.normals import face_normals
from ...meshes.topology import Topology
from ...meshes.uv_mesh import UVMesh
from ..common.geometry.edges import areas, connected_components
from ..common.geometry.unwrap import chart_coordinates

MOST_FACES = 120_000
"""Faces for which xatlas makes charts, in about a minute; more get charts by their normals."""
_MOST_PARTS = 4000  # connected parts, each with charts of its own, that xatlas packs in seconds
_ROUNDS = 4  # rounds of smoothing of the normals that choose a direction
_HALVINGS = 24  # of the interval of scales of a packing
_STEEP = 0.3  # least cosine of a face's normal to the direction of its chart


def make_charts(vertices: Tensor, faces: Tensor, size: int, gutter: int) -> Tensor:
    """Make charts that do not overlap: coordinates [F, 3, 2] of the corners in [0, 1], ``gutter`` texels apart."""
    if len(faces) <= MOST_FACES and int(connected_components(faces).max()) < _MOST_PARTS:
        return chart_coordinates(vertices, faces, size, gutter)
    return _packed(*cone_charts(vertices, faces), size, gutter)


def cone_charts(vertices: Tensor, faces: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Project connected faces with normals near one of six directions along it.

    Returns flat coordinates [N, 2] in world units, the faces [F, 3] as their numbers, and the chart [F] of each.
    """
    normals = -face_normals(vertices[faces])
    count = len(faces)
    pairs = _neighbours(faces)
    ones = np.ones(len(pairs), np.float32)
    near = sparse.coo_matrix((ones, tuple(pairs.T)), shape=(count, count)).tocsr()
    near = near + near.T
    smooth = normals.numpy()
    for _ in range(_ROUNDS):
        smooth = smooth + near @ smooth
        smooth = smooth / np.linalg.norm(smooth, axis=1, keepdims=True).clip(1e-12)
    axes = torch.cat((torch.eye(3), -torch.eye(3)))
    label = (torch.from_numpy(smooth).float() @ axes.T).argmax(1)
    along = normals @ axes.T
    steep = along.gather(1, label[:, None])[:, 0] < _STEEP
    label = torch.where(steep, along.argmax(1), label)
    same = pairs[(label[pairs[:, 0]] == label[pairs[:, 1]]).numpy()]
    joined = sparse.coo_matrix((np.ones(len(same), bool), tuple(same.T)), shape=(count, count))
    chart = torch.from_numpy(csgraph.connected_components(joined, directed=False)[1]).long()
    keys = (chart[:, None] * len(vertices) + faces).reshape(-1)
    unique, corners = torch.unique(keys, return_inverse=True)
    chosen = torch.empty(len(unique), dtype=torch.int64).scatter(0, corners, label.repeat_interleave(3))
    points = vertices[unique % len(vertices)]
    axis, sign = chosen % 3, torch.where(chosen < 3, 1.0, -1.0)
    right = points.gather(1, ((axis + 1) % 3)[:, None])[:, 0] * sign
    up = points.gather(1, ((axis + 2) % 3)[:, None])[:, 0]
    return torch.stack((right, up), 1), corners.view(-1, 3), chart


def _neighbours(faces: Tensor) -> np.ndarray:
    """Find the pairs [N, 2] of faces with a common edge."""
    sides = torch.cat((faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]))
    owner = torch.arange(len(faces)).repeat(3)
    key, order = torch.sort(sides.amin(1) * (int(faces.max()) + 1) + sides.amax(1))
    same = torch.nonzero(key[1:] == key[:-1])[:, 0]
    return torch.stack((owner[order[same]], owner[order[same + 1]]), 1).numpy()


def _packed(places: Tensor, corners: Tensor, chart: Tensor, size: int, gutter: int) -> Tensor:
    """Pack charts into rows that fill a square: [F, 3, 2] in [0, 1]. No two charts share a point."""
    chart_of = torch.empty(len(places), dtype=torch.int64).scatter(0, corners.reshape(-1), chart.repeat_interleave(3))
    index = chart_of[:, None].expand(-1, 2)
    count = int(chart.max()) + 1
    low = torch.full((count, 2), torch.inf).scatter_reduce(0, index, places, "amin")
    high = torch.full((count, 2), -torch.inf).scatter_reduce(0, index, places, "amax")
    boxes = (high - low).double().numpy()
    order = np.argsort(-boxes[:, 1], kind="stable")
    least, most = 0.0, size / max(float(np.sqrt(boxes.prod(1).sum())), 1e-30)
    corner = None
    for _ in range(_HALVINGS):
        scale = (least + most) / 2
        found = _rows(boxes[order] * scale + gutter, size)
        if found is None:
            most = scale
        else:
            least, corner = scale, found
    if corner is None:
        raise ValueError(f"size: expected a larger image for {count} charts with gutters of {gutter}, got {size}")
    begin = np.empty_like(corner)
    begin[order] = corner
    texels = (places - low[chart_of]).double() * least + torch.from_numpy(begin)[chart_of] + gutter / 2
    return (texels / size).float()[corners]


def _rows(boxes: np.ndarray, size: int) -> np.ndarray | None:
    """Place boxes [N, 2], the highest first, in rows of a square: their lower left corners, or None if it is full."""
    corner = np.empty_like(boxes)
    right, base, height = 0.0, 0.0, float(boxes[0, 1])
    for number, (width, tall) in enumerate(boxes.tolist()):
        if right + width > size:
            right, base, height = 0.0, base + height, tall
        if width > size or base + height > size:
            return None
        corner[number] = right, base
        right += width
    return corner


def chart_report(mesh: UVMesh) -> dict[str, float]:
    """Measure charts: texels of a face (median), the share of the images that faces use, and stretch.

    Stretch is the root mean square of the length of a texel over the mean length, weighted by area (Sander et al.,
    "Texture mapping progressive meshes", 2001); 1 is best. Faces that share texels count each, so the share may exceed
    1.
    """
    sizes = [image.shape[1::-1] for image in mesh.images]
    places = mesh.uv.double() * torch.tensor([*sizes, (1, 1)], dtype=torch.float64)[mesh.image_index][:, None]
    texels = areas(functional.pad(places, (0, 1)))
    corners = mesh.vertices[mesh.faces.long()].double()
    area, (p, q, r) = areas(corners), corners.unbind(1)
    (u1, v1), (u2, v2), (u3, v3) = (part.unbind(1) for part in places.unbind(1))
    double = ((u2 - u1) * (v3 - v1) - (u3 - u1) * (v2 - v1))[:, None]
    double = torch.where(double.abs() < 1e-12, 1e-12, double)
    along = (p * (v2 - v3)[:, None] + q * (v3 - v1)[:, None] + r * (v1 - v2)[:, None]) / double
    across = (p * (u3 - u2)[:, None] + q * (u1 - u3)[:, None] + r * (u2 - u1)[:, None]) / double
    square = (along.square().sum(1) + across.square().sum(1)) / 2
    fine = texels > 1e-6
    total = area[fine].sum().clamp(min=1e-30)
    stretch = ((square * area)[fine].sum() / total).sqrt() * (texels[fine].sum() / total).sqrt()
    return {
        "texels_of_a_face": round(float(texels.median()), 2),
        "used_share": round(float(texels.sum()) / max(1, sum(map(math.prod, sizes))), 4),
        "stretch": round(float(stretch), 3),
        "charts": _count_charts(mesh.uv),
    }


def _count_charts(uv: Tensor) -> int:
    """Count the parts of the layout that are connected by equal coordinates."""
    corners = torch.unique(uv.reshape(-1, 2), dim=0, return_inverse=True)[1].view(-1, 3)
    edges = Topology.of(corners).edges.numpy()
    count = int(corners.max()) + 1
    graph = sparse.coo_matrix((np.ones(len(edges), bool), tuple(edges.T)), shape=(count, count))
    return int(csgraph.connected_components(graph, directed=False)[0])
