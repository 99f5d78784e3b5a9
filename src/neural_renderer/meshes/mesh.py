"""A mesh that can be optimised: `Mesh`."""

from __future__ import annotations

import copy
import os
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from .. import validate
from ..io.formats import load_mesh
from ..io.mesh_writer import save_mesh
from ..io.obj import load_obj
from . import primitives
from .bounds import bounding_box


class Mesh(nn.Module):
    """Vertices, faces and a texture, as a module whose parameters are the vertices and the texture.

    `load`, `fromobj` and `icosphere` make one; `save` writes it; `normalize` centres and scales it; `get_batch` and
    `set_lr` are those of the first packages. All other methods are `torch.nn.Module`'s: `to`, `parameters`, ….

    Attributes:
        vertices: Parameter, float32 [V, 3].
        faces: Buffer, int32 [F, 3], indices into the vertices.
        textures: Parameter, float32 [F, T, T, T, 3]. Texel (i, j, k) of a face's cube belongs to barycentric weights
            (i, j, k) / (T - 1) of its corners 0, 1, 2; with T = 1 the face has one colour.

    ``Mesh(vertices, faces, textures)`` copies what it is given (tensors on one device, or numpy arrays). Without
    textures they are 0.05 times normal noise of size ``texture_size``, to be optimised through the sigmoid of
    `get_batch`. ``Mesh("teapot.obj", texture_size, normalization)`` reads the shape from an OBJ file, with such noise.

    Raises:
        TypeError, ValueError: Other types or shapes, tensors on different devices, NaN or infinity, indices out of
            range, no faces, T below 1.
    """

    vertices: nn.Parameter
    faces: Tensor
    textures: nn.Parameter

    def __init__(
        self,
        vertices: Any,
        faces: Any = None,
        textures: Any = None,
        texture_size: int = 4,
        normalization: bool = True,
    ) -> None:
        super().__init__()
        if isinstance(vertices, (str, os.PathLike)):
            # In this form the second and third positions are texture_size and normalization.
            texture_size = texture_size if faces is None else faces
            normalization = normalization if textures is None else textures
            vertices, faces, *_ = load_obj(vertices, normalization)
            textures = None
        vertices, faces = _as_tensor(vertices), _as_tensor(faces)
        validate.floating("vertices", vertices, ["V", 3])
        faces = validate.indices("faces", faces, ["F", 3])
        if not len(faces):
            raise ValueError("faces: expected at least one, got none")
        if textures is None:
            texture_size = validate.whole("texture_size", texture_size, 1)
            textures = 0.05 * torch.randn(len(faces), *[texture_size] * 3, 3, device=vertices.device)
        textures = _as_tensor(textures)
        validate.cubes("textures", textures, len(faces))
        validate.same_device(vertices=vertices, faces=faces, textures=textures)
        validate.finite("vertices", vertices)
        validate.finite("textures", textures)
        validate.in_range("faces", faces, len(vertices))
        self.vertices = nn.Parameter(vertices.detach().to(torch.float32, copy=True))
        self.register_buffer("faces", faces.to(torch.int32, copy=True))
        self.textures = nn.Parameter(textures.detach().to(torch.float32, copy=True))

    @classmethod
    def fromobj(
        cls,
        filename_obj: str | os.PathLike[str],
        normalization: bool = True,
        load_texture: bool = False,
        texture_size: int = 4,
        allow_outside: bool = False,
    ) -> Mesh:
        """Read an OBJ file (see `load_obj`), with its colours or, by default, with noise for a texture."""
        loaded = load_obj(filename_obj, normalization, texture_size, load_texture, allow_outside=allow_outside)
        textures = loaded[2] if len(loaded) == 3 else None
        return cls(loaded[0], loaded[1], textures, texture_size)

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        texture_size: int = 4,
        normalize: bool = False,
        allow_outside: bool = False,
    ) -> Mesh:
        """Read a mesh of any format (see `load_mesh`) with its colours, or white if it has none."""
        vertices, faces, textures = load_mesh(path, texture_size, allow_outside)
        mesh = cls(vertices, faces, _white(faces, texture_size) if textures is None else textures)
        return mesh.normalize() if normalize else mesh

    @classmethod
    def icosphere(cls, level: int = 3, radius: float = 1.0, texture_size: int = 4) -> Mesh:
        """A white sphere of 10·4ˡᵉᵛᵉˡ + 2 vertices (see `primitives.icosphere`)."""
        vertices, faces = primitives.icosphere(level, radius)
        return cls(vertices, faces, _white(faces, texture_size))

    @property
    def num_vertices(self) -> int:
        """V."""
        return len(self.vertices)

    @property
    def num_faces(self) -> int:
        """F."""
        return len(self.faces)

    @property
    def texture_size(self) -> int:
        """T, texels along a cube's edge."""
        return self.textures.shape[1]

    def save(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> None:
        """Write the mesh as OBJ, PLY or GLB (see `save_mesh`), its textures taken as colours and clamped to [0, 1]."""
        save_mesh(path, self.vertices, self.faces, self.textures, overwrite=overwrite)

    def normalize(self) -> Mesh:
        """A copy of the mesh with its bounding box centred at the origin and the box's longest side from -1 to 1.

        Raises ValueError if all vertices coincide, or are not finite.
        """
        result = copy.deepcopy(self)
        with torch.no_grad():
            result.vertices.copy_(centred(self.vertices))
        return result

    def get_batch(self, batch_size: int) -> tuple[Tensor, Tensor, Tensor]:
        """The mesh ``batch_size`` times, as views: vertices [B, V, 3], faces [B, F, 3], textures [B, F, T, T, T, 3].

        The textures are the sigmoid of the parameter, so that optimising it cannot leave [0, 1].
        """
        batch_size = validate.whole("batch_size", batch_size, 0)
        parts = self.vertices, self.faces, torch.sigmoid(self.textures)
        vertices, faces, textures = (part.expand(batch_size, *part.shape) for part in parts)
        return vertices, faces, textures

    def set_lr(self, lr_vertices: float, lr_textures: float) -> None:
        """Set the factors by which `neural_renderer.Adam` multiplies its step for the vertices and the textures.

        They stay with copies and pickles of the mesh, but are no part of its `state_dict`.
        """
        self.vertices.lr = lr_vertices  # type: ignore[attr-defined]
        self.textures.lr = lr_textures  # type: ignore[attr-defined]

    def __deepcopy__(self, memo: dict[int, Any]) -> Mesh:
        result = memo[id(self)] = type(self).__new__(type(self))
        result.__dict__ = copy.deepcopy(self.__dict__, memo)
        for mine, theirs in zip(self.parameters(), result.parameters(), strict=True):
            theirs.__dict__.update(mine.__dict__)  # the rates of `set_lr`, which torch leaves behind
        return result

    def __repr__(self) -> str:
        device = self.vertices.device
        return f"Mesh({self.num_vertices} vertices, {self.num_faces} faces, textures of {self.texture_size}³, {device})"


def centred(vertices: Tensor) -> Tensor:
    """Vertices [V, 3] moved and scaled into [-1, 1] (see `Mesh.normalize`), detached, float64."""
    vertices = validate.vertices(validate.has_numbers("vertices", vertices)).detach().double()
    center, half = bounding_box(vertices)
    if half == 0:
        raise ValueError(f"vertices: expected a mesh to normalise, got {len(vertices)} vertices that all coincide")
    return (vertices - center) / half


def _as_tensor(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        value = torch.from_numpy(value.astype(np.int64) if value.dtype.kind in "iu" else np.ascontiguousarray(value))
    return value


def _white(faces: Tensor, texture_size: int) -> Tensor:
    size = validate.whole("texture_size", texture_size, 1)
    return torch.ones(len(faces), size, size, size, 3, device=faces.device)
