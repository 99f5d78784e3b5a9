"""`EditableMesh`: geometric operations that `Mesh` and `UVMesh` share."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from ..base import validate
from .bounds import centered
from .subdivision import checked_levels, subdivided

if TYPE_CHECKING:
    from typing_extensions import Self


class EditableMesh:
    """Base of meshes with operations that copy them with fewer faces, moved vertices, or more faces.

    Gradients flow through all copies. Parameters of a `Mesh` are parameters of its copies, too.
    """

    vertices: Tensor
    faces: Tensor

    @property
    def num_vertices(self) -> int:
        """Number of vertices V."""
        return self.vertices.shape[-2]

    @property
    def num_faces(self) -> int:
        """Number of faces F."""
        return self.faces.shape[-2]

    def normalize(self) -> Self:
        """Copy the mesh with its bounding box centred at the origin and the box's longest side from −1 to 1.

        Returns:
            The copy. Gradients flow through it, but not through the box.

        Raises:
            ValueError: All vertices coincide, or one is not finite.
        """
        return self._reshaped(centered(self.vertices).float(), self.faces)

    def submesh(self, index: Any) -> Self:
        """Copy some of the faces, with their colours and the vertices that they use.

        Args:
            index: Face indices [N], or a bool for each face [F]: tensor, array or list. Or a slice.

        Returns:
            The copy. Its vertices keep their order.

        Raises:
            TypeError, ValueError: A type or shape does not fit, an index is out of range, or no face is selected.

        Example:
            >>> mesh = nr.Mesh.icosphere(2)
            >>> upper = mesh.submesh((mesh.vertices[mesh.faces][..., 1] > 0).all(1))
            >>> upper.num_faces < mesh.num_faces
            True
        """
        kept = chosen_faces(index, self.faces)
        rows, faces = used_vertices(self.faces[kept])
        return self._reshaped(self.vertices[rows], faces, rows, kept)

    def merge_vertices(self, tolerance: float = 0.0) -> Self:
        """Copy the mesh and merge vertices at the same position, so that adjacent faces share them.

        Files split vertices at seams; losses such as `losses.laplacian`, and smooth normals, need them merged.

        Args:
            tolerance: Width of a grid's cells in world units, ≥ 0; the vertices in one cell are merged. 0 merges equal
                coordinates only.

        Returns:
            The copy, with all faces and their colours. The first vertex at each position is kept, in order. If vertices
            of different colours are merged, these are baked into textures.

        Raises:
            TypeError, ValueError: ``tolerance`` is not a number ≥ 0.

        Example:
            >>> vertices, faces = nr.cube()
            >>> soup = nr.Mesh(vertices[faces].reshape(-1, 3), torch.arange(36).reshape(12, 3))
            >>> soup.num_vertices, soup.merge_vertices().num_vertices
            (36, 8)
        """
        rows, faces = merged_vertices(self.vertices, self.faces, tolerance)
        return self._reshaped(self.vertices[rows], faces, rows)

    def subdivide(self, levels: int = 1, scheme: str = "midpoint") -> Self:
        """Split each face into four, with its colours.

        Args:
            levels: Number of subdivisions, ≥ 1; each multiplies the number of faces by four.
            scheme: "midpoint" keeps the surface and adds the midpoints of edges. "loop" also smooths it, by Loop's
                scheme ("Smooth subdivision surfaces based on triangles", 1987): edges that do not have two faces become
                smooth curves. Merge vertices that the file has split first (`merge_vertices`). "loop" drops normals and
                tangents of a `UVMesh`, which no longer fit.

        Returns:
            The copy. Its first vertices are those of this mesh, moved by "loop"; the children of face f are 4 f to
            4 f + 3.

        Raises:
            TypeError, ValueError: ``levels`` is not a whole number ≥ 1, or the scheme is unknown.

        Example:
            >>> nr.Mesh(*nr.cube()).subdivide(3, "loop").num_faces
            768
        """
        mesh: Any = self
        for _ in range(checked_levels(levels, scheme)):
            mesh = mesh._split(*subdivided(mesh.vertices, mesh.faces, scheme), scheme)
        return mesh

    def _reshaped(self, vertices: Tensor, faces: Tensor, rows: Any = None, kept: Any = None) -> Any:
        """Copy with the vertices of indices ``rows`` and the faces of indices ``kept``; None for all."""
        raise NotImplementedError

    def _split(self, vertices: Tensor, faces: Tensor, scheme: str) -> Any:
        """Copy with each face replaced by its four children."""
        raise NotImplementedError


def chosen_faces(index: Any, faces: Tensor) -> Tensor:
    """Convert a slice, indices [N], or a bool for each face [F], to face indices [N] int64 on the faces' device."""
    if isinstance(index, slice):
        index = range(len(faces))[index]
    try:
        index = torch.as_tensor(index, device=faces.device)
    except (TypeError, ValueError, RuntimeError):
        raise TypeError(f"index: expected face indices, or a bool for each face, got {type(index).__name__}") from None
    if index.dtype == torch.bool:
        if index.shape != faces.shape[:1]:
            raise ValueError(f"index: expected a bool for each of {len(faces)} faces, got {validate.shape_of(index)}")
        index = torch.nonzero(index)[:, 0]
    index = validate.indices("index", index, ("N",), always=True).long()
    validate.in_range("index", index, len(faces), always=True)
    if not len(index):
        raise ValueError("index: expected at least one face, got none")
    return index


def used_vertices(faces: Tensor) -> tuple[Tensor, Tensor]:
    """Find the vertices that faces use: return their indices [N] int64, ascending, and the faces in new indices."""
    rows, numbers = torch.unique(faces.long(), return_inverse=True)
    return rows, numbers.to(faces.dtype)


def merged_vertices(vertices: Tensor, faces: Tensor, tolerance: float) -> tuple[Tensor, Tensor]:
    """Find coincident vertices: return the index of the first at each position, and the faces in new indices.

    The ``tolerance`` is as in `Mesh.merge_vertices`.
    """
    tolerance = validate.not_negative("tolerance", tolerance)
    places = vertices.detach().double()
    places = torch.round(places / tolerance) if tolerance else places
    count = len(vertices)
    place = torch.zeros(count, dtype=torch.int64, device=places.device)
    for column in (places + 0.0).unbind(-1):  # + 0 converts −0 to 0; `unique` of whole rows takes several times as long
        number = torch.unique(column, return_inverse=True)[1]
        place = torch.unique(place * count + number, return_inverse=True)[1]
    numbers = torch.arange(count, device=place.device)
    firsts = numbers.new_full((int(place.max()) + 1 if count else 0,), count).scatter_reduce(0, place, numbers, "amin")
    rows, order = torch.sort(firsts)  # in the order of the mesh, not of the coordinates
    new = torch.empty_like(order).scatter(0, order, torch.arange(len(order), device=order.device))
    return rows, new[place[faces.long()]].to(faces.dtype)
