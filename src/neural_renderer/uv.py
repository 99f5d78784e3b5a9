"""Colour from an image by texture coordinates."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn import functional

from . import validate

WRAPS = ("repeat", "clamp")


def sample_texture(texture: Tensor, uv: Tensor, face_index: Tensor | None = None, *, wrap: str = "repeat") -> Tensor:
    """The colours of a texture image at coordinates, bilinear, and trilinear between mipmaps.

    texture: [h, w, C] or [B or 1, h, w, C] floating, row 0 at the top, any number of channels.
    uv: [B, H, W, 2] floating, u to the right and v up; (0, 0) is the lower left corner of the image, (1, 1) the upper
        right: what `Fragments.interpolate` makes of an OBJ file's coordinates (glTF's v runs down: give 1 - v).
    face_index: [B, H, W], of the `Fragments` that uv belongs to; with it, each pixel takes the mean over about as many
        texels as it covers, by what uv changes between pixels of one face (Williams, "Pyramidal parametrics", 1983);
        None: the texture itself, whose details flicker where they are smaller than a pixel.
    wrap: beyond [0, 1] the image is repeated ("repeat") or its border goes on ("clamp").

    Returns [B, H, W, C] float32. Gradients reach texture and uv; the choice of the mipmap passes none on.
    Raises TypeError or ValueError for other types, shapes, devices or names.
    """
    validate.floating("texture", texture, ("h", "w", "C") if getattr(texture, "ndim", 4) == 3 else ("B", "h", "w", "C"))
    validate.floating("uv", uv, ("B", "H", "W", 2))
    validate.same_device(texture=texture, uv=uv, face_index=face_index)
    if wrap not in WRAPS:
        raise ValueError(f"wrap: expected one of {', '.join(WRAPS)}, got {wrap!r}")
    image = (texture if texture.dim() == 4 else texture[None]).float().permute(0, 3, 1, 2)
    if len(image) not in (1, len(uv)):
        raise ValueError(f"texture: expected a batch of 1 or {len(uv)} like uv, got {len(image)}")
    if 0 in image.shape:
        raise ValueError(f"texture: expected at least one texel and channel, got {validate.shape_of(texture)}")
    image, uv = image.expand(len(uv), -1, -1, -1), uv.float()
    if face_index is None:
        return _bilinear(image, uv, wrap)
    if face_index.shape != uv.shape[:3]:
        raise ValueError(f"face_index: expected {list(uv.shape[:3])} like uv, got {list(face_index.shape)}")
    last = int(math.log2(max(image.shape[2:])))
    level = _level(uv.detach(), face_index, image.shape[3], image.shape[2]).clamp(0, last)
    if not torch.compiler.is_compiling() and not level.is_meta and level.numel():
        last = min(last, math.ceil(float(level.max())))
    result = torch.zeros((), device=uv.device)
    for n in range(last + 1):
        share = (1 - (level - n).abs()).clamp(min=0)[..., None]
        result = result + share * _bilinear(image, uv, wrap)
        half = (max(1, image.shape[2] // 2), max(1, image.shape[3] // 2))
        image = functional.adaptive_avg_pool2d(image, half)
    return result


def _bilinear(image: Tensor, uv: Tensor, wrap: str) -> Tensor:
    height, width = image.shape[2:]
    if wrap == "repeat":
        # A texel of the other side around the image, so that blending goes on across its border.
        image = functional.pad(image, (1, 1, 1, 1), mode="circular")
        size = uv.new_tensor([width, height])
        uv = ((uv - uv.floor()) * size + 1) / (size + 2)
    grid = torch.stack((2 * uv[..., 0] - 1, 1 - 2 * uv[..., 1]), -1)
    colors = functional.grid_sample(image, grid, mode="bilinear", padding_mode="border", align_corners=False)
    return colors.permute(0, 2, 3, 1)


def _level(uv: Tensor, face_index: Tensor, width: int, height: int) -> Tensor:
    """log2 of how many texels a pixel spans along its longer side, [B, H, W]."""
    spans = [_change(uv, face_index, axis) * uv.new_tensor([width, height]) for axis in (1, 2)]
    longest = torch.maximum(*(span.square().sum(-1) for span in spans))
    return 0.5 * longest.clamp(min=1e-20).log2()


def _change(uv: Tensor, face_index: Tensor, axis: int) -> Tensor:
    """What uv changes by from a pixel to the next along an axis, or from the last; 0 where neither shows its face."""
    length = uv.shape[axis]
    if length < 2:
        return torch.zeros_like(uv)
    step = uv.narrow(axis, 1, length - 1) - uv.narrow(axis, 0, length - 1)
    one_face = face_index.narrow(axis, 1, length - 1) == face_index.narrow(axis, 0, length - 1)
    step = step * one_face[..., None]
    none = torch.zeros_like(step.narrow(axis, 0, 1))
    ahead, back = torch.cat((step, none), axis), torch.cat((none, step), axis)
    return torch.where(ahead != 0, ahead, back)
