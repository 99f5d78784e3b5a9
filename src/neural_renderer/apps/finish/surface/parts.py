"""Fewer parts of a mesh with many small ones, such as leaves, grass or loose triangles."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from ....meshes.pieces import used_vertices
from ...common.geometry.defects import border_edges
from ...common.geometry.edges import areas, connected_components
from .decimate import decimate

_SMALL = 0.01  # share of the area below which a part may be left out
_LARGER = 4  # times the median area of small parts, beyond which the largest of them stay
_SHARE_OF_LARGER = 0.25  # of the wished faces that these need at least
_CURVE_BITS = 10  # bits of a coordinate in the order along a space-filling curve
_SHARE_OF_SMALL = 0.5  # of the wished faces that small parts may take, however small their area
_LEAST_FACES, _LEAST_CLOSED = 2, 4  # least number of faces of an open and of a closed part that keep their shape


@dataclass(frozen=True, eq=False)
class Reduced:
    """A surface with fewer faces.

    Attributes:
        vertices: [V, 3], on the original.
        faces: [F, 3] int64.
        moved: [V, 3], the vertices with the parts that remain enlarged.
    """

    vertices: Tensor
    faces: Tensor
    moved: Tensor


def reduced(vertices: Tensor, faces: Tensor, count: int) -> Reduced:
    """Reduce a surface to about ``count`` faces; where parts are too many for these, most small ones are left out.

    An even choice of the small parts remains, each enlarged around its middle so that their area stays the same (Cook,
    Halstead, Planck and Ryu, "Stochastic simplification of aggregate detail", 2007; theirs is random). Parts that are
    much larger than the usual small one stay, unenlarged, while a part of the faces suffices for them.
    """
    component = connected_components(faces)
    area = areas(vertices[faces]).double()
    total = area.new_zeros(int(component.max()) + 1).index_add(0, component, area)
    small = total < _SMALL * area.sum()
    is_open = torch.zeros(len(vertices), dtype=torch.bool)
    is_open[torch.from_numpy(border_edges(faces.numpy())).flatten()] = True
    least = torch.full_like(total, _LEAST_CLOSED).scatter(0, component[is_open[faces].any(1)], float(_LEAST_FACES))
    least = torch.minimum(least, torch.bincount(component))
    if bool(small.any()):
        first = torch.argsort(total, descending=True, stable=True)
        first = first[least[first].cumsum(0) <= _SHARE_OF_LARGER * count]
        small[first] &= total[first] <= _LARGER * total[small].median()
    share = float(total[small].sum() / area.sum())
    numbers = torch.nonzero(small)[:, 0]
    of_small = small[component]
    each = float(least[numbers].mean()) if len(numbers) else 1.0
    most = int(count * max(share, _SHARE_OF_SMALL) / each) if len(numbers) else 0
    if len(faces) <= count or len(numbers) <= most:
        found, triangles = decimate(vertices, faces, count)
        return Reduced(found, triangles, found)
    chosen = torch.zeros_like(small)
    chosen[numbers[_even_choice(_middles(vertices, faces, component)[numbers], max(most, 1))]] = True
    crumbs, pieces = _part(vertices, faces[chosen[component]])
    crumbs, pieces = decimate(crumbs, pieces, math.ceil(max(most, 1) * each))
    left = areas(crumbs[pieces]).double().sum()
    enlarged = _enlarged(crumbs, pieces, float((total[small].sum() / left.clamp(min=1e-30)).sqrt()))
    if bool(small.all()):
        return Reduced(crumbs, pieces, enlarged)
    whole, large = decimate(*_part(vertices, faces[~of_small]), max(count - len(pieces), 1))
    joined = torch.cat((large, pieces + len(whole)))
    return Reduced(torch.cat((whole, crumbs)), joined, torch.cat((whole, enlarged)))


def _part(vertices: Tensor, faces: Tensor) -> tuple[Tensor, Tensor]:
    used, faces = used_vertices(faces)
    return vertices[used], faces


def _middles(vertices: Tensor, faces: Tensor, component: Tensor) -> Tensor:
    """Compute the mean of the corners of each component."""
    corners = vertices[faces].mean(1)
    count = torch.bincount(component)
    return torch.zeros(len(count), 3).index_add(0, component, corners) / count[:, None]


def _even_choice(points: Tensor, count: int) -> Tensor:
    """Choose ``count`` of N points, evenly along a curve that fills their space."""
    order = torch.argsort(_morton_codes(points), stable=True)
    return order[torch.arange(count) * len(points) // count]


def _enlarged(vertices: Tensor, faces: Tensor, scale: float) -> Tensor:
    """Scale each connected part around its middle."""
    component = connected_components(faces)
    component_of = torch.empty(len(vertices), dtype=torch.int64)
    component_of[faces.reshape(-1)] = component.repeat_interleave(3)
    middle = _middles(vertices, faces, component)[component_of]
    return middle + scale * (vertices - middle)


def _morton_codes(points: Tensor) -> Tensor:
    """Interleave the bits of coordinates: nearby points [N, 3] get nearby numbers [N] int64."""
    low, high = points.amin(0), points.amax(0)
    cells = ((points - low) / (high - low).amax().clamp(min=1e-30) * (2**_CURVE_BITS - 1)).long()
    code = torch.zeros_like(cells[:, 0])
    for bit in range(_CURVE_BITS):
        for axis in range(3):
            code |= (cells[:, axis] >> bit & 1) << (3 * bit + axis)
    return code
