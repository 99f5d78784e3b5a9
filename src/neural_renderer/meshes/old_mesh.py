"""Methods of the first packages' `Mesh`."""

from __future__ import annotations

import copy
import os
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

from .. import validate
from ..io.cubes import noise_cubes
from ..io.obj import load_obj

if TYPE_CHECKING:
    from typing_extensions import Self


class OldMesh(nn.Module):
    """Methods of the first packages' `Mesh`: reading with noise, batches through a sigmoid, factors of `Adam`."""

    vertices: nn.Parameter
    faces: Tensor
    textures: nn.Parameter

    @classmethod
    def fromobj(
        cls,
        filename_obj: str | os.PathLike[str],
        normalization: bool = True,
        load_texture: bool = False,
        texture_size: int = 4,
        allow_outside: bool = False,
    ) -> Self:
        """Read an OBJ file.

        Args:
            filename_obj: Path of the file.
            normalization: Centre the bounding box at the origin and scale its longest side to [−1, 1].
            load_texture: Read the colours; otherwise the texture is noise.
            texture_size: T, texels along a cube's edge, ≥ 1.
            allow_outside: Read materials and images outside the file's folder, too. Use it for trusted files only.

        Returns:
            The mesh, on the CPU.

        Raises:
            OSError, TypeError, ValueError: As `load_obj`.

        Example:
            >>> nr.save_obj("cube.obj", *nr.cube())
            >>> nr.Mesh.fromobj("cube.obj", texture_size=2)
            Mesh(8 vertices, 12 faces, textures of 2³, cpu)
        """
        loaded = load_obj(filename_obj, normalization, texture_size, load_texture, allow_outside=allow_outside)
        textures = loaded[2] if len(loaded) == 3 else noise_cubes(loaded[1], texture_size)
        return cls(loaded[0], loaded[1], textures, texture_size)

    def get_batch(self, batch_size: int) -> tuple[Tensor, Tensor, Tensor]:
        """Repeat the mesh ``batch_size`` times, without a copy.

        Args:
            batch_size: B, ≥ 0.

        Returns:
            Vertices [B, V, 3], faces [B, F, 3] and textures [B, F, T, T, T, 3]. The textures are the sigmoid of the
            parameter, so that they stay in [0, 1] during optimisation.

        Raises:
            TypeError, ValueError: ``batch_size`` is not a whole number ≥ 0.

        Example:
            >>> vertices, faces, textures = nr.Mesh.icosphere(2).get_batch(5)
            >>> vertices.shape
            torch.Size([5, 162, 3])
        """
        batch_size = validate.whole("batch_size", batch_size, 0)
        parts = self.vertices, self.faces, torch.sigmoid(self.textures)
        vertices, faces, textures = (part.expand(batch_size, *part.shape) for part in parts)
        return vertices, faces, textures

    def set_lr(self, lr_vertices: float, lr_textures: float) -> None:
        """Set the factors of the learning rate that `neural_renderer.Adam` uses for vertices and textures.

        Copies and pickles of the mesh keep the factors; its `state_dict` does not.

        Args:
            lr_vertices: Factor for the vertices; 0 keeps them.
            lr_textures: Factor for the textures; 0 keeps them.

        Example:
            >>> mesh = nr.Mesh.icosphere(2)
            >>> mesh.set_lr(0.1, 1.0)
            >>> optimizer = nr.Adam(mesh.parameters(), lr=0.01)  # 0.001 for the vertices
        """
        self.vertices.lr = lr_vertices  # type: ignore[attr-defined]
        self.textures.lr = lr_textures  # type: ignore[attr-defined]

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        result = memo[id(self)] = type(self).__new__(type(self))
        result.__dict__ = copy.deepcopy(self.__dict__, memo)
        for mine, theirs in zip(self.parameters(), result.parameters(), strict=True):
            theirs.__dict__.update(mine.__dict__)  # the factors of `set_lr`; torch does not copy them
        return result
