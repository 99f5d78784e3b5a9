"""Base colours of materials, as factors of a mesh's images and colours."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from .color_space import linear_to_srgb, srgb_to_linear
from .material import Material


def tinted_by_materials(
    albedo: Tensor, materials: Sequence[Material], material_index: Tensor | None, face_index: Tensor
) -> Tensor:
    """Multiply the albedo of pixels by the base colours of their materials, in linear light.

    Args:
        albedo: Display values [B, H, W, 3].
        materials: Materials of a mesh.
        material_index: [F] or [B, F], index into the materials, −1 for none; None: all faces have the only material.
        face_index: [B, H, W], the visible face of each pixel, −1 for none.

    Returns:
        Display values [B, H, W, 3], differentiable; the same tensor if all base colours are 1.
    """
    if not any(material.is_tinted for material in materials):
        return albedo
    rows = [material.base_color.to(albedo) for material in materials]
    if material_index is None:
        return linear_to_srgb(srgb_to_linear(albedo) * rows[0])
    table = torch.stack((*rows, torch.ones_like(rows[0])))  # the last one is that of −1
    index = material_index.long().reshape(-1, material_index.shape[-1])
    index = torch.cat((index, index.new_full((len(index), 1), -1)), 1).expand(len(face_index), -1)
    places = face_index.flatten(1).long() % index.shape[1]  # −1 becomes the extra entry
    shown = index.gather(1, places).view(face_index.shape) % len(table)
    return linear_to_srgb(srgb_to_linear(albedo) * table[shown])
