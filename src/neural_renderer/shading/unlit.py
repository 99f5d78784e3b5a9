"""Materials that light leaves as they are (KHR_materials_unlit)."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor

from ..meshes.uv_mesh import UVMesh


def without_unlit(light: Tensor, mesh: Any) -> Tensor:
    """Set the light [B or 1, 2, F, 3] on the faces of a mesh to 1 where their material is unlit."""
    if not isinstance(mesh, UVMesh) or not any(material.unlit for material in mesh.materials):
        return light
    if mesh.material_index is None:
        return torch.ones_like(light)
    flags = torch.tensor([*(material.unlit for material in mesh.materials), False], device=light.device)
    return torch.where(flags[mesh.material_index.long()].reshape(-1, 1, mesh.num_faces, 1), 1.0, light)
