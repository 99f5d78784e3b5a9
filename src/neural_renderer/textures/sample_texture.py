"""Texture lookup with bilinear filtering and mipmaps, in images and cube maps."""

from __future__ import annotations

from typing import Any, TypeAlias

import torch
from torch import Tensor

from ..base import validate
from ..raster.colors.mipmaps import all_levels, cached_pyramid, sample_mipmaps
from .footprints import masked, sample_footprints

WRAPS = ("repeat", "clamp", "mirror")

Wrap: TypeAlias = str | tuple[str, str]
"""One of `WRAPS`, or two of them, for u and for v."""


@validate.checked_together
def sample_texture(
    texture: Tensor,
    uv: Tensor,
    face_index: Tensor | None = None,
    *,
    footprint: Tensor | None = None,
    wrap: Wrap = "repeat",
    max_mip_level: int | None = None,
) -> Tensor:
    """Sample a texture image at texture coordinates, or a cube map at directions.

    With ``footprint`` or ``face_index``, filtering is trilinear (Williams, "Pyramidal parametrics", 1983): the mipmap
    level follows from the longer axis of the ellipse that ``footprint`` describes, or from the difference of uv between
    adjacent pixels of one face. Without both, filtering is bilinear, and details smaller than a pixel alias. Samples of
    cube maps run across the edges of the faces.

    Args:
        texture: [h, w, C] or [B or 1, h, w, C] floating, row 0 at the top, any number of channels. With directions a
            cube map, [6, h, h, C] or [B or 1, 6, h, h, C], its faces +x, −x, +y, −y, +z, −z in OpenGL's orientation.
        uv: [B, H, W, 2] floating, u to the right and v up. (0, 0) is the lower left corner of the image, (1, 1) the
            upper right one. OBJ files use this convention; for glTF pass 1 − v. Or directions, [B, H, W, 3] floating,
            of any length.
        face_index: [B, H, W] integer, `Fragments.face_index` of the pixels, or None. The colour is 0 where it is
            negative.
        footprint: Change of ``uv`` over one pixel, along rows and along columns, [B, H, W, 2 or 3, 2] floating, or
            [B, H, W, 4 or 6] in the order (du/dx, du/dy, dv/dx, dv/dy, …). None: differences between pixels.
        wrap: "repeat" repeats the image beyond [0, 1], "clamp" extends its border, "mirror" repeats the image and its
            mirror image in turn. A pair holds one for u and one for v. Cube maps have no border.
        max_mip_level: The smallest mipmap has 2^-max_mip_level of the image's sides, ≥ 0, so that the tiles of an atlas
            do not blend. None allows all, down to one texel.

    Returns:
        [B, H, W, C] float32, differentiable in ``texture``, ``uv`` and ``footprint``; 0 for directions of length 0.
        Level selection by ``face_index`` is not differentiated.

    Raises:
        TypeError, ValueError: A type, shape, device or name does not fit; while values are checked, also a number that
            is not finite, except in uv and footprint where ``face_index`` is negative.

    Example:
        >>> texture = torch.rand(256, 256, 3, requires_grad=True)
        >>> fragments = nr.fragments(mesh, camera, 128)
        >>> uv = fragments.interpolate(0.5 + 0.5 * mesh.vertices[:, :2])  # any [V, 2] → [B, 128, 128, 2]
        >>> image = fragments.composite(sample_texture(texture, uv, fragments.face_index))
        >>> sky = sample_texture(torch.rand(6, 32, 32, 3), torch.randn(1, 128, 128, 3))  # a cube map
    """
    axes = 3 if getattr(uv, "shape", (2,))[-1:] == (3,) else 2
    single = ("h", "w", "C") if axes == 2 else (6, "h", "h", "C")
    batched = getattr(texture, "ndim", len(single)) != len(single)
    validate.floating("texture", texture, ("B", *single) if batched else single)
    validate.floating("uv", uv, ("B", "H", "W", axes))
    if face_index is not None:
        face_index = validate.indices("face_index", face_index, tuple(uv.shape[:3]))
    if footprint is not None:
        flat = getattr(footprint, "ndim", 5) == 4
        validate.floating("footprint", footprint, (*uv.shape[:3], 2 * axes) if flat else (*uv.shape[:3], axes, 2))
        footprint = footprint.reshape(*uv.shape[:3], axes, 2).float()
    validate.same_device(texture=texture, uv=uv, face_index=face_index, footprint=footprint)
    checked_wrap(wrap)
    image, uv = (texture if batched else texture[None]).float(), uv.float()
    if len(image) not in (1, len(uv)):
        raise ValueError(f"texture: expected a batch of 1 or {len(uv)} like uv, got {len(image)}")
    if 0 in image.shape:
        raise ValueError(f"texture: expected at least one texel and channel, got {validate.shape_of(texture)}")
    if axes == 3 and image.shape[2] != image.shape[3]:
        raise ValueError(f"texture: expected square faces of a cube map, got {validate.shape_of(texture)}")
    validate.finite("texture", image)
    validate.finite("uv", masked(uv, face_index))
    if footprint is not None:
        validate.finite("footprint", masked(footprint, face_index))
    most = None if max_mip_level is None else validate.whole("max_mip_level", max_mip_level, 0)
    return sampled(image, uv, face_index, wrap, most, footprint)


def sampled(
    image: Tensor,
    uv: Tensor,
    face_index: Tensor | None,
    wrap: Wrap,
    max_mip_level: int | None = None,
    footprint: Tensor | None = None,
) -> Tensor:
    """Apply `sample_texture` to valid arguments: image with a batch, float32, as uv and footprint [B, H, W, …, 2]."""
    height, width = image.shape[-3:-1]
    wraps = wrap_pair(wrap)
    if "mirror" in wraps and uv.shape[3] == 2:
        # Bilinear sampling between an image and its mirror image reads the border's texel twice, as "clamp" does.
        folded = 1 - (uv % 2 - 1).abs()
        uv = torch.stack([(folded if w == "mirror" else uv)[..., axis] for axis, w in enumerate(wraps)], -1)
    repeats = [one == "repeat" for one in wraps]
    levels = all_levels(height, width)
    levels = levels if max_mip_level is None else min(levels, max_mip_level + 1)
    if footprint is not None or uv.shape[3] == 3:
        return sample_footprints(image, uv, face_index, footprint, levels, repeats)
    if face_index is None:
        face_index = torch.zeros(uv.shape[:3], dtype=torch.int32, device=uv.device)
        return sample_mipmaps(image.flatten(1, 2), height, width, uv, face_index, 1, *repeats)
    return sample_mipmaps(cached_pyramid(image, levels), height, width, uv, face_index.int(), levels, *repeats)


def checked_wrap(wrap: Any) -> Wrap:
    """Return ``wrap`` if it is a known mode or a pair of them; raise ValueError otherwise."""
    modes = wrap if isinstance(wrap, tuple) and len(wrap) == 2 else (wrap,)
    if not all(isinstance(mode, str) and mode in WRAPS for mode in modes):
        raise ValueError(f"wrap: expected one of {', '.join(WRAPS)}, or a pair of them, got {wrap!r}")
    return wrap


def wrap_pair(wrap: Wrap) -> tuple[str, str]:
    """Return the modes for u and for v."""
    return (wrap, wrap) if isinstance(wrap, str) else wrap
