"""Checks of arguments that several operations share."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from ...base import validate

_MODERATE = 1e-9, 1e9  # sizes of clip coordinates whose products of three are numbers of float32
# Triangle indices are stored in float32 images, which represent integers up to this one.
_MOST_TRIANGLES = 2**24


def float32(name: str, value: Any, shape: Sequence[int | str]) -> Tensor:
    """Return ``value`` if it is a float32 tensor whose shape fits; raise as `validate.floating` otherwise."""
    validate.floating(name, value, shape)
    if value.dtype != torch.float32:
        raise TypeError(f"{name}: expected float32, got {validate.shape_of(value)}")
    return value


def per_vertex(name: str, value: Any, last: int | str) -> Tensor:
    """Check values of vertices, [V, last] in range mode or [B, V, last]; return them with a batch."""
    instanced = getattr(value, "ndim", 3) != 2
    value = float32(name, value, ("B", "V", last) if instanced else ("V", last))
    return value if instanced else value[None]


def clip_positions(value: Any) -> Tensor:
    """Check clip coordinates as `per_vertex`; scale huge and tiny ones by a power of two, which changes no image."""
    positions = per_vertex("pos", value, 4)
    if not positions.numel() or not validate.values_are_checked(positions) or positions.device.type != "cpu":
        return positions
    largest = float(torch.linalg.vector_norm(positions.detach(), math.inf))
    if largest == 0 or _MODERATE[0] <= largest <= _MODERATE[1] or not math.isfinite(largest):
        return positions
    exponent = -math.frexp(largest)[1]
    return positions * 2.0 ** (exponent // 2) * 2.0 ** (exponent - exponent // 2)  # one factor may not be in float32


def triangles(value: Any, vertices: int) -> Tensor:
    """Return ``value`` if it is a tensor of vertex indices, [F, 3] int32; raise otherwise."""
    validate.indices("tri", value, ("F", 3))
    if value.dtype != torch.int32:
        raise TypeError(f"tri: expected int32, got {validate.shape_of(value)}")
    if value.shape[0] > _MOST_TRIANGLES:
        raise ValueError(f"tri: expected at most {_MOST_TRIANGLES} triangles, got {len(value)}")
    validate.in_range("tri", value, vertices)
    return value


def batch_like(name: str, value: Tensor, images: int, of: str) -> None:
    """Raise ValueError unless the batch is 1 or ``images``, that of the argument ``of``."""
    if value.shape[0] not in (1, images):
        raise ValueError(f"{name}: expected a batch of 1 or {images} like {of}, got {validate.shape_of(value)}")
