"""Preview of a mesh: pictures from three sides."""

from __future__ import annotations

import torch
from torch import Tensor

from ...meshes.uv_mesh import UVMesh
from ..common.pictures.photograph import photograph
from ..common.pictures.sheet import sheet

_AZIMUTHS = (150.0, 270.0, 30.0)
_MARGIN = 1.3  # a corner of the box is farther from the centre than its sides


@torch.no_grad()
def preview(mesh: UVMesh, size: int = 256) -> Tensor:
    """Draw a mesh from three sides, [size, 3 · size, 3] uint8."""
    unit = mesh.normalize()
    return sheet([[picture.cpu() for picture in photograph(unit, _AZIMUTHS, size=size, distance=4.2 * _MARGIN)]])
