"""Several meshes as a batch, one for each image, or joined into one scene."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor, nn

from .. import validate
from .mesh import Mesh


def pad(tensors: Sequence[Tensor], value: float = 0) -> Tensor:
    """Stack tensors [N_b, ...] that differ in N only into [B, max N, ...], padded with ``value`` at the end."""
    longest = max(len(tensor) for tensor in tensors)
    spaces = ([0, 0] * (tensor.dim() - 1) + [0, longest - len(tensor)] for tensor in tensors)
    return torch.stack([nn.functional.pad(t, space, value=value) for t, space in zip(tensors, spaces, strict=True)])


def batch(meshes: Sequence[Mesh]) -> tuple[Tensor, Tensor, Tensor]:
    """Pad meshes of different sizes to one batch. `render` does this with a list of meshes.

    Args:
        meshes: B meshes on one device, with one texture size.

    Returns:
        Vertices [B, V, 3], padded with 0; faces [B, F, 3], padded with (−1, −1, −1), which stands for no face; textures
        [B, F, T, T, T, 3]. Gradients reach the tensors of each mesh.

    Raises:
        TypeError, ValueError: An item is not a `Mesh`, or devices or texture sizes differ.

    Example:
        >>> vertices, faces, textures = batch([nr.Mesh.icosphere(1), nr.Mesh.icosphere(2)])
        >>> faces.shape
        torch.Size([2, 320, 3])
    """
    _check(meshes)
    vertices = pad([mesh.vertices for mesh in meshes])
    return vertices, pad([mesh.faces for mesh in meshes], -1), pad([mesh.textures for mesh in meshes])


def join(meshes: Sequence[Mesh]) -> tuple[Tensor, Tensor, Tensor]:
    """Join several meshes into one scene.

    Args:
        meshes: Meshes on one device, with one texture size.

    Returns:
        Vertices [V, 3], faces [F, 3] and textures [F, T, T, T, 3] for `render`. Gradients reach the tensors of each
        mesh; ``Mesh(*join(meshes))`` is an independent copy.

    Raises:
        TypeError, ValueError: An item is not a `Mesh`, or devices or texture sizes differ.

    Example:
        >>> vertices, faces, textures = join([nr.Mesh.icosphere(1), nr.Mesh.icosphere(2)])
        >>> faces.shape
        torch.Size([400, 3])
    """
    _check(meshes)
    firsts = itertools.accumulate((len(mesh.vertices) for mesh in meshes[:-1]), initial=0)
    faces = torch.cat([mesh.faces + first for mesh, first in zip(meshes, firsts, strict=True)])
    return torch.cat([mesh.vertices for mesh in meshes]), faces, torch.cat([mesh.textures for mesh in meshes])


def mesh_parts(mesh: Any) -> tuple[Tensor, Tensor, Tensor | None]:
    """Get (vertices, faces, textures or None) of a `Mesh`, a list of meshes, or a tuple; raise TypeError otherwise."""
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
    """Raise TypeError or ValueError unless all items are meshes on one device with one texture size."""
    if not isinstance(meshes, (list, tuple)) or not all(isinstance(mesh, Mesh) for mesh in meshes):
        kinds = [type(mesh).__name__ for mesh in meshes] if isinstance(meshes, (list, tuple)) else type(meshes).__name__
        raise TypeError(f"meshes: expected a list of Mesh, got {kinds}")
    if not meshes:
        raise ValueError("meshes: expected at least one Mesh, got an empty list")
    validate.same_device(**{f"meshes[{i}]": mesh.vertices for i, mesh in enumerate(meshes)})
    sizes = sorted({mesh.textures.shape[-2] for mesh in meshes})
    if len(sizes) > 1:
        raise ValueError(f"meshes: expected textures of one size, got {' and '.join(map(str, sizes))}")
