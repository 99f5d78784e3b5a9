"""Seamless texture cubes: adjacent faces share the texels on their common edge."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from scipy import sparse
from torch import Tensor

from ...base import validate
from ...io.cubes import trilinear_texels


@dataclass(frozen=True, eq=False)
class Texels:
    """Parameters of a texture, and the linear map from them to texture cubes.

    Faces are adjacent if they share vertex indices. Merge vertices that a file has split at seams before.
    """

    index: Tensor  # [F, L] int64 in [0, count): the texels of each face
    weights: Tensor  # [T³, L], rows of sum 1: each texel of a cube as a linear combination of the face's texels
    size: int  # T, texels along the edge of a cube
    count: int  # number of texels

    @classmethod
    def separate(cls, faces: Tensor, size: int) -> Texels:
        """Assign T³ separate texels to each face [F, 3], as in the paper."""
        texels = validate.whole("texture_size", size, 1) ** 3
        count, device = len(faces) * texels, faces.device
        return cls(
            torch.arange(count, device=device).reshape(-1, texels), torch.eye(texels, device=device), size, count
        )

    @classmethod
    def shared(cls, faces: Tensor, size: int) -> Texels:
        """Place T ≥ 3 texels a side on a triangular lattice on each face; neighbours share those on corners and edges.

        The colours on an edge depend on its own texels only, so that the texture is continuous over the mesh.
        """
        # T = 2 would blend the texel at a face's centre into the colours on its edges.
        size = validate.whole("texture_size", size, 3)
        if not len(faces):
            raise ValueError("faces: expected at least one, got none")
        steps, device = size - 1, faces.device
        points = _lattice(steps).to(device)  # [L, 3]
        corners, vertices = faces.long(), int(faces.max()) + 1
        # The key of a point on an edge is its two vertices, sorted, and its weight for the lower one; at a corner both
        # vertices are the same.
        onto = points > 0
        ids = corners[:, None].expand(-1, len(points), -1)
        low = torch.where(onto, ids, vertices).amin(2)
        high = torch.where(onto, ids, -1).amax(2)
        share = torch.where(onto & (ids == low[..., None]), points, 0).amax(2) % steps
        key = (low * vertices + high) * steps + share
        inside = onto.all(1).expand_as(key)
        unshared = vertices**2 * steps + torch.arange(key.numel(), device=device).reshape(key.shape)
        found, index = torch.unique(torch.where(inside, unshared, key), return_inverse=True)
        return cls(index, _mixture(size).to(device), size, len(found))

    def cubes(self, values: Tensor) -> Tensor:
        """Compute texture cubes [F, T, T, T, C] from values [count, C]; differentiable."""
        texels = F.embedding(self.index, values)
        mixed = torch.einsum("gl,flc->fgc", self.weights, texels)
        return mixed.reshape(len(texels), *(self.size,) * 3, values.shape[1])

    def read(self, faces: np.ndarray, weights: np.ndarray, margin: float) -> sparse.csr_array:
        """Express the colours that the renderer reads at points as a sparse matrix [N, count], times the values.

        Points are given by faces [N] and barycentric weights [N, 3]; ``margin`` is the ``eps`` of `render`.
        """
        texels, shares = trilinear_texels(weights, self.size, margin)
        rows = np.arange(0, texels.size + 1, 8)
        blend = sparse.csr_array((shares.ravel(), texels.ravel(), rows), shape=(len(texels), self.size**3))
        local = blend @ sparse.csr_array(self.weights.cpu().numpy())  # [N, L]
        columns = self.index.cpu().numpy()[np.repeat(faces, np.diff(local.indptr)), local.indices]
        return sparse.csr_array((local.data, columns, local.indptr), shape=(len(texels), self.count))

    def edges(self) -> Tensor:
        """List pairs of texels that are neighbours on the lattice of a face, [E, 2] int64, each once."""
        points = _lattice(self.size - 1)
        distance = (points[:, None] - points).abs().sum(2)  # 2: one step along an edge of the lattice
        sides = torch.nonzero((distance == 2).triu()).to(self.index.device)
        low, high = self.index[:, sides].reshape(-1, 2).sort(1).values.unbind(1)
        pair = torch.unique(low * self.count + high)  # on scalars: much faster than on rows
        return torch.stack((pair // self.count, pair % self.count), 1)

    def from_cubes(self, cubes: Tensor) -> Tensor:
        """Compute values [count, C] that approximate texture cubes [F, T, T, T, C]: means over the faces of a texel."""
        direct = self.weights.argmax(0)  # the texel of the cube that lies at each lattice point
        values = cubes.flatten(1, 3)[:, direct].reshape(-1, cubes.shape[-1])
        total = values.new_zeros(self.count, values.shape[1]).index_add_(0, self.index.reshape(-1), values)
        shares = torch.bincount(self.index.reshape(-1), minlength=self.count)
        return total / shares.clamp(min=1)[:, None]

    def fill_unknown(self, values: Tensor, known: Tensor) -> Tensor:
        """Replace values [count, C] that are not ``known`` [count] by means over adjacent faces, from known ones on.

        A connected component without known texels keeps its values.
        """
        unfinished = self.index  # faces with unknown texels
        while True:
            unfinished = unfinished[~known[unfinished].all(1)]
            share = known[unfinished]
            reached = share.any(1)
            faces, share = unfinished[reached], share[reached].to(values.dtype)[..., None]
            if not len(faces):
                return values
            mean = (values[faces] * share).sum(1) / share.sum(1)
            flat, mean = faces.reshape(-1), mean.repeat_interleave(faces.shape[1], 0)
            total = torch.zeros_like(values).index_add_(0, flat, mean)
            count = values.new_zeros(self.count).index_add_(0, flat, values.new_ones(len(flat)))
            new = (count > 0) & ~known
            values = torch.where(new[:, None], total / count.clamp(min=1)[:, None], values)
            known = known | new


def _lattice(steps: int) -> Tensor:
    """List all triples of integers (i, j, k) ≥ 0 with sum ``steps``, [L, 3]."""
    return torch.tensor([(i, j, steps - i - j) for i in range(steps + 1) for j in range(steps + 1 - i)])


def _mixture(size: int) -> Tensor:
    """Express the texels of a cube as linear interpolation between lattice points, [T³, L]."""
    steps = size - 1
    place = {tuple(point): row for row, point in enumerate(_lattice(steps).tolist())}
    weights = torch.zeros(size**3, len(place))
    for row, texel in enumerate(torch.cartesian_prod(*[torch.arange(size)] * 3).tolist()):
        texel = texel if any(texel) else [1, 1, 1]
        total = sum(texel)
        low, rest = zip(*(divmod(part * steps, total) for part in texel), strict=True)
        upward = sum(rest) <= total  # the orientation of the lattice triangle that contains the texel
        for corner in range(3):
            share = rest[corner] / total if upward else 1 - rest[corner] / total
            point = tuple(low[axis] + ((axis == corner) == upward) for axis in range(3))
            if share and sum(rest):
                weights[row, place[point]] += share
        if not sum(rest):
            weights[row, place[low]] = 1
    return weights
