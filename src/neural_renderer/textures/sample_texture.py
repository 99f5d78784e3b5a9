"""Colour from an image by texture coordinates."""

from __future__ import annotations

import torch
from torch import Tensor

from .. import validate
from ..raster.ops.mipmaps import pyramid, sample_mipmaps

WRAPS = ("repeat", "clamp")


def sample_texture(texture: Tensor, uv: Tensor, face_index: Tensor | None = None, *, wrap: str = "repeat") -> Tensor:
    """The colours of a texture image at coordinates, bilinear, and trilinear between mipmaps.

    texture: [h, w, C] or [B or 1, h, w, C] floating, row 0 at the top, any number of channels.
    uv: [B, H, W, 2] floating, u to the right and v up; (0, 0) is the lower left corner of the image, (1, 1) the upper
        right: what `Fragments.interpolate` makes of an OBJ file's coordinates (glTF's v runs down: give 1 - v).
    face_index: [B, H, W], of the `Fragments` that uv belongs to; with it, each pixel takes the mean over about as many
        texels as it covers, by what uv changes between pixels of one face (Williams, "Pyramidal parametrics", 1983);
        None: the texture itself, whose details flicker where they are smaller than a pixel. Where it is below 0 the
        colour is 0.
    wrap: beyond [0, 1] the image is repeated ("repeat") or its border goes on ("clamp").

    Returns [B, H, W, C] float32. Gradients reach texture and uv; the choice of the mipmap passes none on.
    Raises TypeError or ValueError for other types, shapes, devices or names; while values are checked, also for numbers
    that are not finite, but for uv where face_index is below 0.
    """
    validate.floating("texture", texture, ("h", "w", "C") if getattr(texture, "ndim", 4) == 3 else ("B", "h", "w", "C"))
    validate.floating("uv", uv, ("B", "H", "W", 2))
    if face_index is not None:
        face_index = validate.indices("face_index", face_index, tuple(uv.shape[:3]))
    validate.same_device(texture=texture, uv=uv, face_index=face_index)
    checked_wrap(wrap)
    image, uv = (texture if texture.dim() == 4 else texture[None]).float(), uv.float()
    if len(image) not in (1, len(uv)):
        raise ValueError(f"texture: expected a batch of 1 or {len(uv)} like uv, got {len(image)}")
    if 0 in image.shape:
        raise ValueError(f"texture: expected at least one texel and channel, got {validate.shape_of(texture)}")
    validate.finite("texture", image)
    validate.finite("uv", uv if face_index is None else torch.where(face_index[..., None] < 0, 0.0, uv))
    return sampled(image, uv, face_index, wrap)


def sampled(image: Tensor, uv: Tensor, face_index: Tensor | None, wrap: str) -> Tensor:
    """`sample_texture` of arguments that are checked already: image [B or 1, h, w, C] float32, uv float32."""
    height, width = image.shape[1:3]
    if face_index is None:
        face_index = torch.zeros(uv.shape[:3], dtype=torch.int32, device=uv.device)
        return sample_mipmaps(image.flatten(1, 2), height, width, uv, face_index, False, wrap == "repeat")
    texels = pyramid(image.permute(0, 3, 1, 2))
    return sample_mipmaps(texels, height, width, uv, face_index.int(), True, wrap == "repeat")


def checked_wrap(wrap: str) -> str:
    """``wrap`` if it is one; ValueError otherwise."""
    if not isinstance(wrap, str) or wrap not in WRAPS:
        raise ValueError(f"wrap: expected one of {', '.join(WRAPS)}, got {wrap!r}")
    return wrap
