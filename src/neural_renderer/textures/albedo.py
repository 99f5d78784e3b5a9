"""Albedo of the pixels of a `UVMesh`: images, colours of faces without an image, and base colours of materials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from ..base.constants import read_once
from ..raster.visible import VisibleFaces
from ..raster.warp.registration import is_eager
from .color_space import tinted
from .material import Material
from .sample_texture import Wrap, sampled


def sampled_albedo(
    visible: VisibleFaces,
    uv: Tensor,
    image_index: Tensor,
    colors: Tensor,
    images: Sequence[Tensor],
    wraps: Sequence[Wrap],
) -> Tensor:
    """Sample images, with mipmaps, and the colours of faces without an image: display values [B, H, W, 3] float32.

    The result is differentiable. Attributes of faces are as in `UVMesh`, or have a leading batch dimension.
    """
    if uv.dim() == 4:
        rows = []
        for row, numbers in enumerate(read_once(image_index, _numbers_of_rows)):
            places = torch.full((len(images) + 1,), -1, device=uv.device)  # −1 stays −1
            places[numbers] = torch.arange(len(numbers), device=uv.device)
            drawn = slice(None) if len(uv) == 1 else slice(row, row + 1)
            row_visible = replace(
                visible, corners=visible.corners[drawn], face_index=visible.face_index[drawn], half_edges=None
            )
            chosen = [images[number] for number in numbers], [wraps[number] for number in numbers]
            rows.append(sampled_albedo(row_visible, uv[row], places[image_index[row]], colors[row], *chosen))
        return torch.cat(rows)

    def at_pixels(values: Tensor) -> Tensor:
        """Interpolate values of the faces' corners, [F, 3, C]."""
        return visible.at_pixels(values[None].float())

    parts = []  # terms of a sum; at each pixel, all but one are 0
    # Tracing cannot read values, so it always adds the colours of faces, which are 0 where faces have images.
    if not images or not is_eager((image_index,)) or read_once(image_index, has_negative):
        parts.append(at_pixels(colors * (image_index < 0)[:, None, None]))
    if images:
        places, shown = at_pixels(uv), None
        if len(images) > 1 or parts:
            # Face −1 (background) reads the extra entry at the end.
            shown = torch.cat((image_index, image_index.new_full((1,), -1)))[visible.face_index.long()]
        for number, (image, wrap) in enumerate(zip(images, wraps, strict=True)):
            shown_faces = visible.face_index if shown is None else torch.where(shown == number, visible.face_index, -1)
            parts.append(sampled(image[None].float(), places, shown_faces, wrap))
    return parts[0] if len(parts) == 1 else torch.stack(parts).sum(0)


def corner_values(visible: VisibleFaces, values: Tensor) -> Tensor:
    """Interpolate values of the faces' corners, [F, 3, C] or [B, F, 3, C]: [B, H, W, C] float32; differentiable."""
    return visible.at_pixels((values if values.dim() == 4 else values[None]).float())


def tinted_by_materials(
    albedo: Tensor, materials: Sequence[Material], material_index: Tensor | None, face_index: Tensor
) -> Tensor:
    """Multiply the albedo [B, H, W, 3] of pixels by the base colours of materials, in linear light; differentiable.

    ``material_index`` is the material of each face, [F] or [B, F], −1 for none; None: all faces have the only material.
    If all base colours are 1, ``albedo`` itself is returned.
    """
    if not any(material.is_tinted for material in materials):
        return albedo
    rows = [material.base_color.to(albedo) for material in materials]
    if material_index is None:
        return tinted(albedo, rows[0])
    table = torch.stack((*rows, torch.ones_like(rows[0])))  # last entry: no material, −1
    index = material_index.long().reshape(-1, material_index.shape[-1])
    index = torch.cat((index, index.new_full((len(index), 1), -1)), 1).expand(len(face_index), -1)
    places = face_index.flatten(1).long() % index.shape[1]  # −1 becomes the extra entry
    shown = index.gather(1, places).view(face_index.shape) % len(table)
    return tinted(albedo, table[shown])


def has_negative(index: Tensor) -> bool:
    """Return whether there is a face without an image."""
    return bool((index < 0).any())


def _numbers_of_rows(index: Tensor) -> list[list[int]]:
    """Find the images that each mesh of a batch uses."""
    return [sorted({number for number in row if number >= 0}) for row in index.tolist()]
