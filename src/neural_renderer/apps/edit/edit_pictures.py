"""Pictures of an edit: six views before and after, previews, and turntables."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import torch
from torch import Tensor

from ...meshes.bounds import bounding_box
from ...meshes.mesh import Mesh
from ...meshes.pieces import used_vertices
from ...meshes.uv_mesh import UVMesh
from ..common.pictures.photograph import photograph, turntable
from ..common.pictures.sheet import sheet
from .edit import MeshEdit

_FRONT = 150.0  # azimuth of the first picture, in degrees
_PREVIEW = (_FRONT, 270.0, 30.0)  # azimuths of a preview
_ELEVATION, _VIEWING_ANGLE = 20.0, 19.0  # degrees
_MARGIN = 1.03  # factor on the least distance at which the whole mesh is in the picture


def six_views(before: Mesh | UVMesh, after: Mesh | UVMesh, size: int = 320) -> Tensor:
    """Draw a mesh before and after an edit from six sides, in two rows: [2 · size, 6 · size, 3] uint8."""
    pair = [normalized_like(mesh, before) for mesh in (before, after)]
    angles = [_FRONT + 60 * index for index in range(6)]
    return sheet([[picture.cpu() for picture in photographs(mesh, angles, size)] for mesh in pair])


def preview(edit: MeshEdit, size: int = 256) -> Tensor:
    """Draw the current mesh of an edit from three sides, [size, 3 · size, 3] uint8."""
    mesh = edit.mesh()
    return sheet([[picture.cpu() for picture in photographs(normalized_like(mesh, mesh), _PREVIEW, size)]])


def turntable_pictures(mesh: Mesh | UVMesh, frames: int, size: int = 320) -> list[Tensor]:
    """Draw one turn of a mesh, pictures [3, size, size] in [0, 1]."""
    mesh = normalized_like(mesh, mesh)
    return list(turntable(mesh, frames, _FRONT, size=size, **_camera_around(mesh)))


@torch.no_grad()
def normalized_like(mesh: Mesh | UVMesh, other: Mesh | UVMesh) -> Mesh | UVMesh:
    """Apply to ``mesh`` the map that scales ``other``, with the same faces, to [-1, 1]³; drop unused vertices."""
    used, faces = used_vertices(mesh.faces)
    center, half = bounding_box(other.vertices[used])
    vertices = (mesh.vertices[used] - center) / half
    if isinstance(mesh, UVMesh):
        return replace(mesh, vertices=vertices, faces=faces)
    return Mesh(vertices, faces, mesh.cubes())


def photographs(mesh: Mesh | UVMesh, angles: list[float] | tuple[float, ...], size: int) -> Iterator[Tensor]:
    """Draw a mesh around the origin from azimuths in degrees, each picture [3, size, size] with the whole mesh."""
    view = _camera_around(mesh)
    return iter(photograph(mesh, angles, size=size, **view))


def _camera_around(mesh: Mesh | UVMesh) -> dict[str, float]:
    """Choose the arguments of `photograph` that show a whole mesh around the origin from any azimuth."""
    radius = mesh.vertices.detach().norm(dim=1).max().item()
    distance = _MARGIN * radius / math.sin(math.radians(_VIEWING_ANGLE))
    return {"elevation": _ELEVATION, "distance": distance, "viewing_angle": _VIEWING_ANGLE}
