"""`Meshes`: meshes of different sizes, as lists, packed one after the other, or padded."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from ....meshes.normals import vertex_normals
from ....meshes.topology import Topology
from ...common.geometry.edges import area_vectors

if TYPE_CHECKING:
    from typing_extensions import Self


class Meshes:
    """N meshes: vertices [V, 3] and faces [F, 3] of each, or tensors [N, V, 3] and [N, F, 3], padded with -1."""

    def __init__(self, verts: Any, faces: Any, textures: Any = None, *, verts_normals: Any = None) -> None:
        self._verts = [*verts]
        self._faces = [each.long() if (each >= 0).all() else each[(each >= 0).all(1)].long() for each in faces]
        if len(self._verts) != len(self._faces):
            raise ValueError(f"verts, faces: expected as many of both, got {len(verts)} and {len(faces)}")
        self._normals = None if verts_normals is None else [*verts_normals]
        self.device = self._verts[0].device if self._verts else torch.device("cpu")
        self.textures = textures
        if textures is not None:
            textures.fit(self)

    def __len__(self) -> int:
        return len(self._verts)

    def __getitem__(self, index: Any) -> Meshes:
        rows = _rows(index, len(self))
        textures = None if self.textures is None else self.textures[rows]
        return self._with([self._verts[i] for i in rows], [self._faces[i] for i in rows], textures)

    _N = property(__len__)
    _V = property(lambda self: max(map(len, self._verts), default=0))
    _F = property(lambda self: max(map(len, self._faces), default=0))

    def isempty(self) -> bool:
        return not any(map(len, self._faces))

    def verts_list(self) -> list[Tensor]:
        return self._verts

    def faces_list(self) -> list[Tensor]:
        return self._faces

    def verts_packed(self) -> Tensor:
        return torch.cat(self._verts)

    def faces_packed(self) -> Tensor:
        first = self.mesh_to_verts_packed_first_idx().tolist()
        return torch.cat([faces + start for faces, start in zip(self._faces, first, strict=True)])

    def verts_padded(self) -> Tensor:
        return pad_sequence(self._verts, batch_first=True)

    def faces_padded(self) -> Tensor:
        return pad_sequence(self._faces, batch_first=True, padding_value=-1)

    def num_verts_per_mesh(self) -> Tensor:
        return torch.tensor([len(each) for each in self._verts], device=self.device)

    def num_faces_per_mesh(self) -> Tensor:
        return torch.tensor([len(each) for each in self._faces], device=self.device)

    def mesh_to_verts_packed_first_idx(self) -> Tensor:
        return self.num_verts_per_mesh().cumsum(0) - self.num_verts_per_mesh()

    def mesh_to_faces_packed_first_idx(self) -> Tensor:
        return self.num_faces_per_mesh().cumsum(0) - self.num_faces_per_mesh()

    def verts_packed_to_mesh_idx(self) -> Tensor:
        return torch.arange(len(self), device=self.device).repeat_interleave(self.num_verts_per_mesh())

    def faces_packed_to_mesh_idx(self) -> Tensor:
        return torch.arange(len(self), device=self.device).repeat_interleave(self.num_faces_per_mesh())

    def edges_packed(self) -> Tensor:
        return Topology.of(self.faces_packed()).edges

    def faces_packed_to_edges_packed(self) -> Tensor:
        """Return the edges across from the three corners of each face, rows of `edges_packed`, [F, 3]."""
        faces, edges = self.faces_packed(), self.edges_packed()
        ends, count = torch.stack((faces.roll(-1, 1), faces.roll(-2, 1)), 2), sum(map(len, self._verts))
        return torch.searchsorted(edges[:, 0] * count + edges[:, 1], ends.amin(2) * count + ends.amax(2))

    def verts_normals_list(self) -> list[Tensor]:
        if self._normals is not None:
            return self._normals
        return [vertex_normals(verts, faces)[0] for verts, faces in zip(self._verts, self._faces, strict=True)]

    def verts_normals_packed(self) -> Tensor:
        return torch.cat(self.verts_normals_list())

    def verts_normals_padded(self) -> Tensor:
        return pad_sequence(self.verts_normals_list(), batch_first=True)

    def faces_normals_packed(self) -> Tensor:
        return torch.nn.functional.normalize(self._doubled(), dim=-1, eps=1e-6)

    def faces_normals_list(self) -> list[Tensor]:
        return [*self.faces_normals_packed().split([len(each) for each in self._faces])]

    def faces_normals_padded(self) -> Tensor:
        return pad_sequence(self.faces_normals_list(), batch_first=True)

    def faces_areas_packed(self) -> Tensor:
        return self._doubled().norm(dim=-1) / 2

    def get_mesh_verts_faces(self, index: int) -> tuple[Tensor, Tensor]:
        return self._verts[index], self._faces[index]

    def get_bounding_boxes(self) -> Tensor:
        return torch.stack([torch.stack((each.amin(0), each.amax(0)), -1) for each in self._verts])

    def offset_verts(self, vert_offsets_packed: Tensor) -> Meshes:
        moved = self.verts_packed() + vert_offsets_packed
        return self._with([*moved.split([len(each) for each in self._verts])])

    def offset_verts_(self, vert_offsets_packed: Tensor) -> Self:
        self._verts, self._normals = self.offset_verts(vert_offsets_packed)._verts, None
        return self

    def scale_verts(self, scale: Any) -> Meshes:
        factors = scale if isinstance(scale, Tensor) and scale.ndim else [scale] * len(self)
        return self._with([each * factors[row] for row, each in enumerate(self._verts)])

    def scale_verts_(self, scale: Any) -> Self:
        self._verts, self._normals = self.scale_verts(scale)._verts, None
        return self

    def update_padded(self, new_verts_padded: Tensor) -> Meshes:
        return self._with([new[: len(old)] for new, old in zip(new_verts_padded, self._verts, strict=True)])

    def extend(self, N: int) -> Meshes:
        return self[[i for i in range(len(self)) for _ in range(N)]]

    def sample_textures(self, fragments: Any) -> Tensor:
        if self.textures is None:
            raise ValueError("meshes: expected textures, got None")
        return self.textures.sample_textures(fragments, faces_packed=self.faces_packed())

    def clone(self) -> Meshes:
        return self._each(Tensor.clone)

    def detach(self) -> Meshes:
        return self._each(Tensor.detach)

    def to(self, device: Any, copy: bool = False) -> Meshes:
        return self._each(lambda value: value.to(device, copy=copy))

    def cpu(self) -> Meshes:
        return self.to("cpu")

    def cuda(self) -> Meshes:
        return self.to("cuda")

    def _each(self, change: Callable[[Tensor], Tensor]) -> Meshes:
        textures = None if self.textures is None else self.textures.each(change)
        return self._with([*map(change, self._verts)], [*map(change, self._faces)], textures)

    def _with(self, verts: list[Tensor], faces: list[Tensor] | None = None, textures: Any = None) -> Meshes:
        made = copy.copy(self)
        made._verts, made._normals = verts, None
        if faces is not None:
            made._faces, made.textures = faces, textures
        made.device = verts[0].device if verts else self.device
        return made

    def _doubled(self) -> Tensor:
        """Compute the cross products of two edges of all faces."""
        return area_vectors(self.verts_packed()[self.faces_packed()])


def join_meshes_as_batch(meshes: Sequence[Meshes], include_textures: bool = True) -> Meshes:
    """Join several batches to one."""
    textures = [each.textures for each in meshes]
    joined = None if not include_textures or textures[0] is None else textures[0].join_batch(textures[1:])
    return Meshes([v for each in meshes for v in each._verts], [f for each in meshes for f in each._faces], joined)


def join_meshes_as_scene(meshes: Any, include_textures: bool = True) -> Meshes:
    """Join all meshes to one; of textures, only colours of vertices."""
    batch = meshes if isinstance(meshes, Meshes) else join_meshes_as_batch(meshes, include_textures)
    textures = batch.textures.join_scene() if include_textures and batch.textures is not None else None
    return Meshes([batch.verts_packed()], [batch.faces_packed()], textures)


def packed_to_list(x: Tensor, split_size: Any) -> list[Tensor]:
    """Cut rows into parts of the given lengths."""
    return [*x.split(split_size.tolist() if isinstance(split_size, Tensor) else split_size)]


def _rows(index: Any, count: int) -> list[int]:
    if isinstance(index, int):
        return [index]
    if isinstance(index, list) and all(isinstance(i, int) for i in index):
        return index
    return torch.atleast_1d(torch.arange(count)[index.cpu() if isinstance(index, Tensor) else index]).tolist()
