"""What an edit leaves in its folder to look at."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from ...io import save_animation
from ...meshes.mesh import Mesh
from ...meshes.uv_mesh import UVMesh
from ...pictures.photograph import photograph
from ...pictures.sheet import sheet
from .edit import MeshEdit

_FRONT, _ELEVATION, _ANGLE = 150.0, 20.0, 19.0


def six_views(before: Mesh | UVMesh, after: Mesh | UVMesh, size: int = 320) -> Tensor:
    """A mesh from six sides, and below how it is now, as in the paper's figures: [2 · size, 6 · size, 3] uint8."""
    pair = [framed(mesh, before) for mesh in (before, after)]
    angles = [_FRONT + 60 * index for index in range(6)]
    return sheet([[picture.cpu() for picture in photographs(mesh, angles, size)] for mesh in pair])


def preview(edit: MeshEdit, size: int = 256) -> Tensor:
    """The mesh as it is now from three sides: [size, 3 · size, 3] uint8."""
    mesh = edit.mesh()
    return sheet([[picture.cpu() for picture in photographs(framed(mesh, mesh), (_FRONT, 270.0, 30.0), size)]])


def turntable(folder: Path, mesh: Mesh | UVMesh, frames: int = 36, size: int = 320) -> None:
    """Write ``turntable.mp4`` and ``turntable.gif`` of a mesh that goes round once."""
    angles = [_FRONT + 360 * index / frames for index in range(frames)]
    pictures = [picture.cpu() for picture in photographs(framed(mesh, mesh), angles, size)]
    save_animation(folder / "turntable.mp4", pictures, fps=15)
    save_animation(folder / "turntable.gif", pictures, fps=15)


@torch.no_grad()
def framed(mesh: Mesh | UVMesh, other: Mesh | UVMesh) -> Mesh | UVMesh:
    """The mesh as it stands when ``other``, of the same faces, fills [-1, 1]³ and is in its middle."""
    used, faces = torch.unique(mesh.faces, return_inverse=True)  # without vertices of no face
    low, high = other.vertices[used].amin(0), other.vertices[used].amax(0)
    vertices = (mesh.vertices[used] - (low + high) / 2) * (2 / (high - low).max())
    faces = faces.to(mesh.faces.dtype)
    if isinstance(mesh, UVMesh):
        return replace(mesh, vertices=vertices, faces=faces)
    return Mesh(vertices, faces, mesh.textures)


def photographs(mesh: Mesh | UVMesh, angles: list[float] | tuple[float, ...], size: int) -> Iterator[Tensor]:
    """One picture [3, size, size] from each of the angles, from where all of a mesh around the origin is seen."""
    radius = mesh.vertices.detach().norm(dim=1).max().item()
    distance = 1.03 * radius / math.sin(math.radians(_ANGLE))
    for angle in angles:
        yield photograph(mesh, angle, _ELEVATION, size, distance=distance, viewing_angle=_ANGLE)
