"""The interface of `cumesh`, as far as the export of TRELLIS.2 uses it: an independent implementation, on the CPU."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
from scipy import sparse
from scipy.sparse import csgraph
from torch import Tensor

from ....base.requirements import import_library
from ....meshes.normals import vertex_normals
from ....meshes.pieces import used_vertices
from ...common.geometry.defects import first_of_equal_faces
from ...common.geometry.edges import areas, connected_components
from ...common.geometry.holes import border_loops, lids, some_loops
from ...common.geometry.unwrap import chart_coordinates
from .bvh import cuBVH
from .remesh import remesh_narrow_band_dc

__all__ = ["CuMesh", "cuBVH", "remeshing"]
_CHART_SIZE, _GUTTER = 1024, 8  # pixels of the image that charts are packed for, and between them


def __getattr__(name: str) -> Any:
    raise AttributeError(f"cumesh: expected one of {', '.join(__all__)}, got {name}, which is not here")


remeshing = SimpleNamespace(remesh_narrow_band_dc=remesh_narrow_band_dc)


class CuMesh:
    """A mesh that is cleaned, simplified and unwrapped in place."""

    def __init__(self) -> None:
        self._vertices, self._faces = torch.zeros(0, 3), torch.zeros(0, 3, dtype=torch.int64)
        self._normals: Tensor | None = None

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(f"CuMesh: expected a method that the export uses, got {name}, which is not here")

    def init(self, vertices: Tensor, faces: Tensor) -> None:
        """Take vertices [V, 3] and faces [F, 3]."""
        self._vertices, self._faces, self._normals = vertices.detach().float(), faces.long(), None

    @property
    def num_vertices(self) -> int:
        """Number of vertices."""
        return len(self._vertices)

    @property
    def num_faces(self) -> int:
        """Number of faces."""
        return len(self._faces)

    def read(self) -> tuple[Tensor, Tensor]:
        """Return vertices [V, 3] float32 and faces [F, 3] int32."""
        return self._vertices.clone(), self._faces.int()

    def compute_vertex_normals(self) -> None:
        """Compute the normals that `read_vertex_normals` returns."""
        self._normals = vertex_normals(self._vertices, self._faces)[0]

    def read_vertex_normals(self) -> Tensor:
        """Return the normals of vertices, [V, 3]."""
        if self._normals is None:
            self.compute_vertex_normals()
        return self._normals  # type: ignore[return-value]

    def remove_faces(self, face_mask: Tensor) -> None:
        """Remove the faces whose bool [F] is true, and the vertices that no other face uses."""
        rows, faces = used_vertices(self._faces[~face_mask])
        self.init(self._vertices[rows], faces)

    def remove_duplicate_faces(self) -> None:
        """Keep the first of the faces with the same three vertices."""
        self.remove_faces(~first_of_equal_faces(self._faces))

    def remove_degenerate_faces(self, abs_thresh: float = 1e-24, rel_thresh: float = 1e-12) -> None:
        """Remove faces whose area is below the first limit, and below the second times the longest side's square."""
        corners = self._vertices[self._faces].double()
        sides = corners.roll(-1, 1) - corners
        area = areas(corners)
        longest = sides.square().sum(2).amax(1)
        repeated = (self._faces == self._faces.roll(1, 1)).any(1)
        self.remove_faces(repeated | ((area < abs_thresh) & (area < rel_thresh * longest)))

    def remove_small_connected_components(self, min_area: float) -> None:
        """Remove connected components with an area below a limit."""
        if not self.num_faces:
            return
        component = connected_components(self._faces)
        area = areas(self._vertices[self._faces].double())
        total = area.new_zeros(int(component.max()) + 1).index_add(0, component, area)
        self.remove_faces(total[component] < min_area)

    def repair_non_manifold_edges(self) -> None:
        """Split vertices, so that only faces at an edge of two faces are connected."""
        count = self.num_faces
        face, side, _, second, _ = self._pairs()
        # Corners [3 F] at both ends of such an edge are one vertex.
        ends = []
        for corner in (0, 1):
            here = (side[face] + corner) % 3
            there = _same_vertex(self._faces, face // 3, here, second // 3)
            ends.append(np.stack((face // 3 * 3 + here, second // 3 * 3 + there)))
        rows, columns = np.concatenate(ends, 1)
        graph = sparse.coo_matrix((np.ones(len(rows), bool), (rows, columns)), shape=(3 * count,) * 2)
        number, group = csgraph.connected_components(graph, directed=False)
        vertex = np.zeros(number, np.int64)
        vertex[group] = self._faces.cpu().numpy().ravel()
        device = self._faces.device
        faces = torch.from_numpy(group.astype(np.int64)).view(-1, 3).to(device)
        self.init(self._vertices[torch.from_numpy(vertex).to(device)], faces)

    def unify_face_orientations(self) -> None:
        """Flip faces so that each connected component has the orientation of its first face."""
        count = self.num_faces
        first, _, _, second, same = self._pairs()
        first, second = first // 3, second // 3
        # Each face has two nodes, one for each orientation. Edges connect nodes of adjacent faces that are consistent.
        rows = np.concatenate((first, first + count))
        columns = np.concatenate((second + same * count, second + ~same * count))
        graph = sparse.coo_matrix((np.ones(len(rows), bool), (rows, columns)), shape=(2 * count,) * 2)
        label = csgraph.connected_components(graph, directed=False)[1]
        turned = torch.from_numpy(label[:count] > label[count:]).to(self._faces.device)
        self.init(self._vertices, torch.where(turned[:, None], self._faces.flip(1), self._faces))

    def fill_holes(self, max_hole_perimeter: float = 3e-2) -> None:
        """Close holes of at most this perimeter by triangles around the mean of their vertices."""
        edges, loop = border_loops(self._faces)
        if not len(edges):
            return
        ends = self._vertices[edges]
        length = (ends[:, 0] - ends[:, 1]).norm(dim=1)
        perimeter = length.new_zeros(int(loop.max()) + 1).index_add(0, loop, length)
        middle, faces = lids(self._vertices, *some_loops(edges, loop, perimeter <= max_hole_perimeter))
        self.init(torch.cat((self._vertices, middle)), torch.cat((self._faces, faces)))

    def simplify(self, target_num_faces: int, verbose: bool = False, options: Any = None) -> None:
        """Reduce the number of faces by quadrics, with the library fast-simplification."""
        if self.num_faces <= target_num_faces:
            return
        library = import_library("fast_simplification", "to simplify meshes")
        arrays = self._vertices.cpu().numpy(), self._faces.cpu().numpy()
        vertices, faces = library.simplify(*arrays, target_count=int(target_num_faces))
        device = self._vertices.device
        self.init(torch.from_numpy(vertices).to(device), torch.from_numpy(faces.astype(np.int64)).to(device))

    def uv_unwrap(
        self,
        compute_charts_kwargs: Any = None,
        xatlas_compute_charts_kwargs: Any = None,
        xatlas_pack_charts_kwargs: Any = None,
        return_vmaps: bool = False,
        verbose: bool = False,
    ) -> tuple[Tensor, ...]:
        """Cut the mesh into charts with the library xatlas, whose own settings replace the given ones.

        Returns vertices [N, 3], split at seams, faces [F, 3] int32, coordinates [N, 2] in [0, 1], and with
        ``return_vmaps`` the index [N] of each vertex before the split.
        """
        self.remove_degenerate_faces()
        corners = chart_coordinates(self._vertices, self._faces, _CHART_SIZE, _GUTTER).view(-1, 2)
        index = self._faces.reshape(-1)
        rows = torch.cat((index[:, None].double(), corners.double()), 1)
        found, faces = torch.unique(rows, dim=0, return_inverse=True)
        vertex = found[:, 0].long()
        result = self._vertices[vertex], faces.view(-1, 3).int(), found[:, 1:].float()
        return (*result, vertex) if return_vmaps else result

    def _pairs(self) -> tuple[np.ndarray, ...]:
        """Find the edges that two faces share, by the numbers of their half-edges.

        Half-edge 3 f + s is side s of face f.

        Returns:
            The first half-edges; side and first vertex of every half-edge; the second half-edges; and whether both
            half-edges of a pair run in the same direction.
        """
        faces = self._faces.cpu().numpy()
        starts, stops = faces.ravel(), np.roll(faces, -1, 1).ravel()
        key = np.minimum(starts, stops) * (int(faces.max(initial=0)) + 1) + np.maximum(starts, stops)
        order = np.argsort(key, kind="stable")
        ordered = key[order]
        begins = np.flatnonzero(np.r_[True, ordered[1:] != ordered[:-1]])
        pairs = begins[np.diff(np.r_[begins, len(ordered)]) == 2]
        first, second = order[pairs], order[pairs + 1]
        side = np.tile(np.arange(3), len(faces))
        return first, side, starts, second, starts[first] == starts[second]


def _same_vertex(faces: Tensor, face: np.ndarray, corner: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Find the corner of other faces that is the vertex of a corner of faces."""
    corners = faces.cpu().numpy()
    return (corners[other] == corners[face, corner][:, None]).argmax(1)
