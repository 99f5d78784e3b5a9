"""Several meshes at once: side by side in a batch, or together in one scene."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn

from .. import validate
from .mesh import Mesh


def pad(tensors: Sequence[Tensor], value: float = 0) -> Tensor:
    """Tensors [N_b, ...] that differ in N alone, as one [B, max N, ...], filled up with ``value`` behind."""
    longest = max(len(tensor) for tensor in tensors)
    spaces = ([0, 0] * (tensor.dim() - 1) + [0, longest - len(tensor)] for tensor in tensors)
    return torch.stack([nn.functional.pad(t, space, value=value) for t, space in zip(tensors, spaces, strict=True)])


def batch(meshes: Sequence[Mesh]) -> tuple[Tensor, Tensor, Tensor]:
    """Meshes of different size as one batch for `render`, which takes a list of them likewise.

    Returns vertices [B, V, 3], filled up with zeros, faces [B, F, 3], filled up with (-1, -1, -1), which stands for no
    face, and textures [B, F, T, T, T, 3]. Gradients reach each mesh's own tensors.
    Raises TypeError or ValueError for anything but meshes of one device and one texture size.
    """
    _check(meshes)
    vertices = pad([mesh.vertices for mesh in meshes])
    return vertices, pad([mesh.faces for mesh in meshes], -1), pad([mesh.textures for mesh in meshes])


def join(meshes: Sequence[Mesh]) -> tuple[Tensor, Tensor, Tensor]:
    """Several objects as one scene for `render`: vertices [V, 3], faces [F, 3] and textures [F, T, T, T, 3] of all.

    Gradients reach each mesh's own tensors; ``Mesh(*join(meshes))`` is a copy of its own.
    Raises TypeError or ValueError for anything but meshes of one device and one texture size.
    """
    _check(meshes)
    firsts = itertools.accumulate((len(mesh.vertices) for mesh in meshes[:-1]), initial=0)
    faces = torch.cat([mesh.faces + first for mesh, first in zip(meshes, firsts, strict=True)])
    return torch.cat([mesh.vertices for mesh in meshes]), faces, torch.cat([mesh.textures for mesh in meshes])


def mesh_parts(mesh: Any) -> tuple[Tensor, Tensor, Tensor | None]:
    """(vertices, faces, textures or None) of a `Mesh`, a list of them, or a tuple; TypeError for anything else."""
    if isinstance(mesh, Mesh):
        return mesh.vertices, mesh.faces, mesh.textures
    if isinstance(mesh, list):
        return batch(mesh)
    if isinstance(getattr(mesh, "vertices", None), Tensor) and isinstance(getattr(mesh, "faces", None), Tensor):
        return mesh.vertices, mesh.faces, None
    if isinstance(mesh, tuple) and len(mesh) in (2, 3):
        return mesh[0], mesh[1], mesh[2] if len(mesh) == 3 else None
    raise TypeError(
        f"mesh: expected a Mesh, a list of them, a UVMesh, (vertices, faces) or (vertices, faces, textures), all of "
        f"tensors, got {type(mesh).__name__}"
    )


def _check(meshes: Sequence[Mesh]) -> None:
    if not isinstance(meshes, (list, tuple)) or not all(isinstance(mesh, Mesh) for mesh in meshes):
        kinds = [type(mesh).__name__ for mesh in meshes] if isinstance(meshes, (list, tuple)) else type(meshes).__name__
        raise TypeError(f"meshes: expected a list of Mesh, got {kinds}")
    if not meshes:
        raise ValueError("meshes: expected at least one Mesh, got an empty list")
    validate.same_device(**{f"meshes[{i}]": mesh.vertices for i, mesh in enumerate(meshes)})
    sizes = sorted({mesh.textures.shape[-2] for mesh in meshes})
    if len(sizes) > 1:
        raise ValueError(f"meshes: expected textures of one size, got {' and '.join(map(str, sizes))}")
