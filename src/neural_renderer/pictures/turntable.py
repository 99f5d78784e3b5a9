"""Turntables: pictures of a mesh from all sides."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from torch import Tensor

from ..meshes.mesh import Mesh
from ..meshes.uv_mesh import UVMesh
from .photograph import photograph

FIRST_AZIMUTH = 145.0
"""Azimuth of the first picture in degrees: a front view, turned a little."""


def turntable(mesh: Mesh | UVMesh, frames: int, first_azimuth: float = FIRST_AZIMUTH, **view: Any) -> Iterator[Tensor]:
    """Photograph a mesh in about [-1, 1]³ during one turn around the y axis; ``view`` goes to `photograph`.

    Returns pictures [3, H, W] float32 in [0, 1], on the CPU, one at a time.
    """
    return (photograph(mesh, first_azimuth + 360 * index / frames, **view).cpu() for index in range(frames))
