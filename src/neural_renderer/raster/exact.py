"""Drawing in float64, in plain torch: slow, with derivatives of any order by textures, light and attributes."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any, NoReturn

import torch
from torch import Tensor
from torch.nn import functional

from .outputs import Images
from .reference.operators import barycentrics_reference, sample_textures_reference
from .visible import VisibleFaces
from .warp.registration import differentiable, fake, operator


def checked_dtype(dtype: Any) -> torch.dtype:
    """Return float32 or float64, or raise TypeError."""
    if dtype is torch.float32 or dtype is torch.float64:
        return dtype
    raise TypeError(f"dtype: expected torch.float32 or torch.float64, got {dtype!r}")


@operator
def fixed(values: Tensor, corners: Tensor) -> Tensor:
    """Copy values that depend on corners, or the corners, to float64.

    A gradient to the corners is an error (RuntimeError): there is none through visibility.
    """
    return values.to(torch.float64, copy=True)


@fake(fixed)
def _(values: Tensor) -> Tensor:
    return values.new_empty(values.shape, dtype=torch.float64)


def _refuse(ctx: Any, grad: Any) -> NoReturn:
    raise RuntimeError(
        "dtype=torch.float64: expected vertices and cameras that need no gradient, got one to compute; drawing in "
        "float64 has none through visibility (use float32 for them, or detach them)"
    )


differentiable(fixed, _refuse, None, _refuse)


def exact_images(
    visible: VisibleFaces,
    faces: Tensor,
    outputs: Collection[str],
    textures: Tensor | None = None,
    light: Tensor | None = None,
    background: Tensor | None = None,
) -> Images:
    """Make images in float64, from the corners [B, F, 3, 3] floating of visible faces.

    Textures, light and background are as in `sample_textures`, floating, if "rgb" is among the outputs.
    """
    settings, index = visible.settings, visible.face_index
    corners = fixed(faces, faces)
    limits = (settings.near, settings.far, settings.perspective)
    weights, depth = barycentrics_reference(corners, index, *limits)
    layers = {}
    if textures is not None and light is not None and background is not None:
        options = (settings.eps, settings.perspective)
        layers["rgb"] = sample_textures_reference(
            textures, light, background, corners.detach(), index, weights, *options
        )
    layers |= {"alpha": fixed(visible.mask[:, None], corners), "depth": depth[:, None]}
    if settings.anti_aliasing:
        layers = {name: functional.avg_pool2d(layer, 2) for name, layer in layers.items()}
    flat = {name: layers[name].squeeze(1) for name in ("alpha", "depth") if name in outputs}
    return Images(rgb=layers.get("rgb"), **flat)


def exact_interpolate(visible: VisibleFaces, attributes: Tensor) -> Tensor:
    """Interpolate attributes of corners, [1 or B, F, 3, C] floating, at every pixel: [B, H, W, C] float64."""
    settings, index = visible.settings, visible.face_index
    limits = (settings.near, settings.far, settings.perspective)
    weights, _ = barycentrics_reference(fixed(visible.corners, visible.corners), index, *limits)
    batch = torch.arange(len(index), device=index.device)[:, None, None]
    corner_values = attributes.double().expand(len(index), *attributes.shape[1:])[batch, index.clamp(min=0).long()]
    return (weights[..., None] * corner_values).sum(-2)
