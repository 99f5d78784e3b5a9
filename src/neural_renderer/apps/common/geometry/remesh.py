"""Isotropic remeshing: faces become nearly equilateral, with edges of a given length."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from ....base import validate
from ....base.one_line import OneLine
from .closest_points import ClosestFaces
from .edges import area_vectors
from .operations import collapse_short, flip_edges, move_safely, relax, split_long
from .sample_points import checked_surface
from .surface import Surface

_MOST_SPLITS = 12  # most halvings of all edges before the first pass
_PROJECTED = 2  # number of last passes that project vertices to the surface
_MOST_FACES = 20_000_000


@dataclass(frozen=True, eq=False, repr=False)
class Remeshed(OneLine):
    """A remeshed surface; the result of `remesh`.

    Attributes:
        vertices: [V, 3], of the dtype of the old vertices.
        faces: [F, 3] int64.
        attributes: [V, C], values carried along, or None.

    Example:
        >>> found = nr.remesh(nr.icosphere(2), 0.2, attributes=torch.rand(162, 8))
        >>> len(found.attributes) == len(found.vertices)
        True
    """

    vertices: Tensor
    faces: Tensor
    attributes: Tensor | None


@torch.no_grad()
def remesh(
    mesh: Any,
    edge_length: float | Tensor,
    *,
    attributes: Tensor | None = None,
    passes: int = 5,
    project: bool = True,
) -> Remeshed:
    """Remesh a surface towards a given edge length, by splits, collapses and flips of edges.

    Each pass splits edges longer than 4/3 of the length, collapses those shorter than 4/5, flips edges towards six
    neighbours of each vertex, and smooths along the surface (Botsch and Kobbelt, "A Remeshing Approach to
    Multiresolution Modeling", 2004). The operations are vectorised over edges. A closed manifold stays a closed
    manifold of the same topology. Boundary edges, and edges of more than two faces, are only split. Merge vertices that
    a file has split first (`Mesh.merge_vertices`). Sharp edges become blunt by up to one edge length.

    Args:
        mesh: `Mesh`, `UVMesh`, or (vertices [V, 3], faces [F, 3]). Textures are not carried along.
        edge_length: Length in world units, > 0; or one for each vertex, [V], interpolated between them.
        attributes: Values of vertices to carry along, [V, C] floating: a new vertex gets the mean of its edge's ends.
        passes: Number of passes, ≥ 1. The first reaches the edge length; the others improve the shape of faces.
        project: Whether the last two passes project vertices to the old surface. Without it, curved parts shrink a
            little.

    Returns:
        Vertices, faces and attributes, detached.

    Raises:
        TypeError, ValueError: An argument does not fit, a value is not finite, an index is out of range, or the result
            would have too many faces.

    Example:
        >>> vertices, faces = nr.torus(segments=12, sides=6)
        >>> found = nr.remesh((vertices, faces), 0.1)
        >>> len(found.faces) > 10 * len(faces)
        True
        >>> finer_above = nr.remesh((vertices, faces), torch.where(vertices[:, 1] > 0, 0.05, 0.1))
    """
    vertices, faces = checked_surface(mesh, always=True)
    vertices = vertices.detach()
    values = [vertices, _lengths_of_vertices(edge_length, vertices)]
    if attributes is not None:
        attributes = validate.floating("attributes", attributes, (len(vertices), "C")).detach()
        validate.same_device(vertices=vertices, attributes=attributes)
        values.append(attributes.to(vertices.dtype))
    passes = validate.whole("passes", passes, 1)
    if not len(faces):
        raise ValueError("mesh: expected at least one face, got none")
    _check_size(vertices, faces, values[1][:, 0])
    faces = faces[(faces != faces.roll(1, 1)).all(1)]
    tree = ClosestFaces(vertices, faces) if validate.flag("project", project) else None
    surface = Surface(torch.cat(values, 1), faces).compact()
    for _ in range(_MOST_SPLITS):
        before = len(surface.faces)
        surface = split_long(surface)
        if len(surface.faces) == before:
            break
    for index in range(passes):
        surface = remesh_once(surface, tree if index >= passes - _PROJECTED else None)
    carried = surface.values[:, 4:].to(attributes.dtype) if attributes is not None else None
    return Remeshed(surface.vertices.clone(), surface.faces, carried)


def remesh_once(surface: Surface, tree: ClosestFaces | None = None, rounds: int = 4, strength: float = 0.5) -> Surface:
    """Do one pass: split, collapse, flip (at most ``rounds`` times), smooth, and project to the surface of a tree."""
    surface = relax(flip_edges(collapse_short(split_long(surface), rounds), rounds), strength)
    if tree is None:
        return surface
    fixed = surface.edges.fixed[:, None]
    goal = torch.where(fixed, surface.vertices, tree.project(surface.vertices))
    return surface.moved(move_safely(surface.vertices, goal, surface.faces))


def _lengths_of_vertices(edge_length: Any, vertices: Tensor) -> Tensor:
    """Check the target length of edges; return a length per vertex, [V, 1]."""
    if not isinstance(edge_length, Tensor):
        return vertices.new_full((len(vertices), 1), validate.positive("edge_length", edge_length))
    validate.floating("edge_length", edge_length, (len(vertices),))
    validate.same_device(vertices=vertices, edge_length=edge_length)
    if not bool(((edge_length > 0) & edge_length.isfinite()).all()):
        raise ValueError("edge_length: expected finite lengths above 0, got zero, negative or infinite ones")
    return edge_length.detach().to(vertices.dtype)[:, None]


def _check_size(vertices: Tensor, faces: Tensor, target: Tensor) -> None:
    """Raise ValueError if the result would have too many faces."""
    area = area_vectors(vertices[faces]).double().norm(dim=1) / 2
    count = float((area / (3**0.5 / 4 * target[faces].double().mean(1).square())).sum())
    if count > _MOST_FACES:
        raise ValueError(
            f"edge_length: expected a length that gives at most {_MOST_FACES:,} faces, got one for about {count:,.0f}"
        )
