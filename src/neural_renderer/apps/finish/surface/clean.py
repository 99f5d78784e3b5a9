"""Cleaning of a mesh: one vertex at each position, no doubled faces, no parts that nobody sees, no small holes."""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from torch import Tensor

from ....meshes.pieces import merged_vertices, used_vertices
from ....rendering.deferred import fragments
from ...common.geometry.defects import equal_faces, faced_both_ways
from ...common.geometry.edges import areas, connected_components
from ...common.geometry.extent import extent
from ...common.geometry.holes import border_loops, lids, some_loops
from .silhouettes import cameras_outside

_SAME = 1e-7  # vertices this near to each other are one, relative to the longest side
_VIEWS, _PIXELS = 26, 512  # cameras that look for visible parts, and the side of their pictures
_OUTLINE = 0.5  # a hole with a longer side, relative to its connected part, is an outline
_MOST_LOST = 0.01  # share of the area that small pieces may have together
_HOLES = ("holes", "faces added in holes")  # what the last step closed


@dataclass(frozen=True, eq=False)
class CleanMesh:
    """A clean surface, without colours.

    Attributes:
        vertices: [V, 3] float32, each used.
        faces: [F, 3] int64.
        kept: [K] int64, the faces of the original that remain; the first K faces. Those after them close holes.
        both_sides: [K] bool, whether a face stood for another one that faced the opposite way.
        removed: What each step removed or added, by name.
    """

    vertices: Tensor
    faces: Tensor
    kept: Tensor
    both_sides: Tensor
    removed: dict[str, int] = field(default_factory=dict)


@torch.no_grad()
def clean(vertices: Tensor, faces: Tensor, *, inside: bool, pieces: float, holes: float) -> CleanMesh:
    """Clean a surface of vertices [V, 3] and faces [F, 3].

    ``inside`` keeps parts that no view from outside sees. Connected parts are removed if their longest side is below
    ``pieces`` of the mesh's, and holes are closed if theirs is below ``holes``. ValueError: Nothing remains.
    """
    removed: dict[str, int] = {}
    kept = torch.arange(len(faces))

    def keep(name: str, good: Tensor) -> None:
        nonlocal kept, faces
        removed[name] = int((~good).sum())
        kept, faces = kept[good], faces[good]

    faces = faces.long()
    in_range = ((faces >= 0) & (faces < len(vertices))).all(1)
    keep("faces with vertices that do not exist", in_range)
    keep("faces with numbers that are not finite", torch.isfinite(vertices).all(1)[faces].all(1))
    _some(faces)
    used, corners = used_vertices(faces)
    points = vertices[used].double()
    center, half = extent(points)
    rows, faces = merged_vertices((points - center) / half, corners, _SAME)
    removed["vertices at the place of others"] = len(points) - len(rows)
    points = points[rows]
    keep("faces with two equal corners", (faces != faces.roll(1, 1)).all(1))
    if not len(faces):
        raise ValueError(
            f"mesh: expected faces longer than {_SAME:g} of the mesh, got none; its longest side is {2 * half:g}"
        )
    if not bool(areas(points[faces] / half).any()):
        raise ValueError("mesh: expected a face with an area, got vertices in a line")
    group, first = equal_faces(faces)
    opposite = kept[faced_both_ways(faces, group)]
    keep("doubled faces", first)
    component = connected_components(faces)
    sizes = _longest_sides(points, faces, component)
    keep("faces of small pieces", ~_small(points, faces, component, sizes < 2 * half * pieces))
    if not inside:
        component = connected_components(faces)
        if int(component.max()) > 0:
            added, fans = lids(points, *_holes(points, faces, 2 * half * holes))
            closed = torch.cat((points, added))
            seen = _seen(((closed - center) / half).float(), torch.cat((faces, fans)))
            seen = seen[seen < len(faces)]
            visible = torch.zeros(int(component.max()) + 1, dtype=torch.bool)
            visible[component[seen]] = True
            keep("faces of parts that no view sees", visible[component])
            _some(faces)
    edges, loop = _holes(points, faces, 2 * half * holes)
    added, fans = lids(points, edges, loop)
    removed |= dict(zip(_HOLES, (int(loop.max()) + 1 if len(loop) else 0, len(fans)), strict=True))
    points, faces = torch.cat((points, added)), torch.cat((faces, fans))
    used, faces = used_vertices(faces)
    return CleanMesh(points[used].float(), faces, kept, torch.isin(kept, opposite), removed)


def _some(faces: Tensor) -> None:
    if not len(faces):
        raise ValueError("mesh: expected at least one face with three different, finite corners, got none")


def _longest_sides(points: Tensor, parts: Tensor, component: Tensor) -> Tensor:
    """Compute the longest side of the bounding box of each component of faces [N, 3], or of edges [N, 2]."""
    count = int(component.max()) + 1
    index = component.repeat_interleave(parts.shape[1])[:, None].expand(-1, 3)
    corners = points[parts].reshape(-1, 3)
    low = torch.full((count, 3), torch.inf, dtype=points.dtype).scatter_reduce(0, index, corners, "amin")
    high = torch.full((count, 3), -torch.inf, dtype=points.dtype).scatter_reduce(0, index, corners, "amax")
    return (high - low).amax(1)


def _small(points: Tensor, faces: Tensor, component: Tensor, small: Tensor) -> Tensor:
    """Select the faces of small components [C] bool; none if these are more than 1 % of the area."""
    area = areas(points[faces])
    chosen = small[component]
    return chosen & bool(area[chosen].sum() <= _MOST_LOST * area.sum())


def _seen(points: Tensor, faces: Tensor) -> Tensor:
    """Find the faces [N] that cameras around a mesh in [-1, 1]³ see."""
    seen = torch.zeros(len(faces) + 1, dtype=torch.bool)
    for camera in cameras_outside(_VIEWS):
        drawn = fragments((points, faces.int()), camera, _PIXELS, anti_aliasing=False)
        seen[drawn.face_index.long().flatten()] = True  # −1 is the extra entry
    return torch.nonzero(seen[:-1])[:, 0]


def _holes(points: Tensor, faces: Tensor, longest: float) -> tuple[Tensor, Tensor]:
    """Find the edges of holes whose longest side is below ``longest``, as `border_loops`.

    A loop with more than half of the extent of its connected part is the outline of an open part, such as a leaf.
    """
    edges, loop = border_loops(faces)
    if not len(edges):
        return edges, loop
    component = connected_components(faces)
    of_vertex = torch.empty(len(points), dtype=torch.int64)
    of_vertex[faces.reshape(-1)] = component.repeat_interleave(3)
    part = _longest_sides(points, faces, component)[of_vertex[edges[:, 0]]]
    size = _longest_sides(points, edges, loop)
    limit = torch.empty_like(size).scatter(0, loop, (_OUTLINE * part).clamp(max=longest))
    return some_loops(edges, loop, size <= limit)


def summary(removed: dict[str, int]) -> list[str]:
    """List what each step removed or closed; steps without effect are left out."""
    holes, added = (removed.get(name, 0) for name in _HOLES)
    lines = [f"removed {count:,} {name}" for name, count in removed.items() if count and name not in _HOLES]
    return lines + ([f"closed {holes:,} holes with {added:,} faces"] if holes else [])
