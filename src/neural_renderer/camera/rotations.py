"""Conversion of axis and angle, quaternions and the 6D representation to rotation matrices, and back.

A matrix [..., 3, 3] rotates a point X to R · X: its columns are the rotated axes. Every function takes any leading
dimensions, computes in at least float32, and is differentiable wherever its result is smooth.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.nn import functional

from ..base import validate
from .parameters import as_tensor

_SMALL = 1e-4  # square of a sine or an angle below which series are exact in float64


def from_axis_angle(vectors: Any) -> Tensor:
    """Convert rotation vectors, axis times angle, to matrices (Rodrigues' formula).

    Args:
        vectors: [..., 3] floating: the axis, whose length is the angle in radians, counter-clockwise seen from its tip.

    Returns:
        [..., 3, 3]. The gradient at 0 is that of the generators of rotations.

    Raises:
        TypeError, ValueError: A type or shape does not fit.

    Example:
        >>> from_axis_angle(torch.tensor([0.0, 0.0, torch.pi])).diagonal()
        tensor([-1., -1.,  1.])
    """
    x, y, z = (vectors := _checked("vectors", vectors, 3)).unbind(-1)
    zero = torch.zeros_like(x)
    cross = torch.stack((zero, -z, y, z, zero, -x, -y, x, zero), -1).unflatten(-1, (3, 3))
    square = vectors.square().sum(-1)[..., None, None]
    is_small = square < _SMALL
    angle = torch.where(is_small, 1.0, square).sqrt()
    first = torch.where(is_small, 1 - square / 6 + square.square() / 120, angle.sin() / angle)
    half = (angle / 2).sin() / angle
    second = torch.where(is_small, 0.5 - square / 24 + square.square() / 720, 2 * half.square())
    return torch.eye(3, dtype=x.dtype, device=x.device) + first * cross + second * (cross @ cross)


def to_axis_angle(matrices: Any) -> Tensor:
    """Convert matrices to rotation vectors, axis times angle in [0, π]; the inverse of `from_axis_angle`.

    Args:
        matrices: [..., 3, 3] floating, rotations.

    Returns:
        [..., 3]. At an angle of π the axis may have either sign, and the gradient jumps.

    Raises:
        TypeError, ValueError: A type or shape does not fit.

    Example:
        >>> to_axis_angle(torch.tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
        tensor([0.0000, 0.0000, 1.5708])
    """
    w, vector = to_quaternion(matrices).split((1, 3), -1)
    square = vector.square().sum(-1, keepdim=True)
    is_small = square < _SMALL
    sine = torch.where(is_small, 1.0, square).sqrt()
    # Angle over the sine of its half; for small angles, the Taylor series of 2 asin(s) / s.
    series = 2 + square / 3 + 3 * square.square() / 20
    return vector * torch.where(is_small, series, 2 * torch.atan2(sine, w) / sine)


def from_quaternion(quaternions: Any) -> Tensor:
    """Convert quaternions to matrices.

    Args:
        quaternions: [..., 4] floating: (w, x, y, z), the real part **first**, of any length above 0.

    Returns:
        [..., 3, 3]. The length of a quaternion has no gradient.

    Raises:
        TypeError, ValueError: A type or shape does not fit.

    Example:
        >>> from_quaternion(torch.tensor([0.0, 0.0, 0.0, 2.0]))  # half a turn around z
        tensor([[-1.,  0.,  0.],
                [ 0., -1.,  0.],
                [ 0.,  0.,  1.]])
    """
    w, x, y, z = functional.normalize(_checked("quaternions", quaternions, 4), dim=-1, eps=1e-30).unbind(-1)
    rows = (
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return torch.stack(rows, -1).unflatten(-1, (3, 3))


def to_quaternion(matrices: Any) -> Tensor:
    """Convert matrices to unit quaternions (w, x, y, z) with w ≥ 0; the inverse of `from_quaternion`.

    Args:
        matrices: [..., 3, 3] floating, rotations.

    Returns:
        [..., 4]. At half turns, where w is 0, q and −q are the same rotation, and the result jumps between them.

    Raises:
        TypeError, ValueError: A type or shape does not fit.

    Example:
        >>> to_quaternion(torch.eye(3))
        tensor([1., 0., 0., 0.])
    """
    m = _checked("matrices", matrices, 3, 3)
    (a, b, c), (d, e, f), (g, h, i) = (row.unbind(-1) for row in m.unbind(-2))
    # The symmetric matrix 4 q qᵀ. Its row with the largest diagonal element is q times a number that is not small
    # (Shepperd, "Quaternion from rotation matrix", 1978).
    outer = (
        *(1 + a + e + i, h - f, c - g, d - b),
        *(h - f, 1 + a - e - i, b + d, c + g),
        *(c - g, b + d, 1 - a + e - i, f + h),
        *(d - b, c + g, f + h, 1 - a - e + i),
    )
    table = torch.stack(outer, -1).unflatten(-1, (4, 4))
    largest = table.diagonal(dim1=-2, dim2=-1).argmax(-1)[..., None, None]
    row = table.gather(-2, largest.expand(*largest.shape[:-1], 4))[..., 0, :]
    row = torch.where(row[..., :1] < 0, -row, row)
    return functional.normalize(row, dim=-1)


def from_6d(numbers: Any) -> Tensor:
    """Convert the continuous 6D representation to matrices, by Gram and Schmidt's method.

    Zhou et al., "On the continuity of rotation representations in neural networks" (CVPR 2019).

    Args:
        numbers: [..., 6] floating: two vectors that are not parallel, from which the first two **columns** are made
            (PyTorch3D: rows).

    Returns:
        [..., 3, 3].

    Raises:
        TypeError, ValueError: A type or shape does not fit.

    Example:
        >>> from_6d(torch.tensor([2.0, 0.0, 0.0, 5.0, 0.0, 3.0]))
        tensor([[ 1.,  0.,  0.],
                [ 0.,  0., -1.],
                [ 0.,  1.,  0.]])
    """
    first, second = _checked("numbers", numbers, 6).split(3, -1)
    first = functional.normalize(first, dim=-1, eps=1e-30)
    second = functional.normalize(second - (first * second).sum(-1, keepdim=True) * first, dim=-1, eps=1e-30)
    return torch.stack((first, second, torch.linalg.cross(first, second)), -1)


def to_6d(matrices: Any) -> Tensor:
    """Convert matrices to their first two columns, one after the other; the inverse of `from_6d`.

    Args:
        matrices: [..., 3, 3] floating, rotations.

    Returns:
        [..., 6].

    Raises:
        TypeError, ValueError: A type or shape does not fit.

    Example:
        >>> to_6d(torch.eye(3))
        tensor([1., 0., 0., 0., 1., 0.])
    """
    return _checked("matrices", matrices, 3, 3)[..., :2].transpose(-1, -2).flatten(-2)


def _checked(name: str, value: Any, *shape: int) -> Tensor:
    """Return finite numbers [..., *shape] in at least float32; raise TypeError or ValueError otherwise."""
    value = as_tensor(name, value, torch.get_default_dtype())
    leading = ["..."] * (value.ndim - len(shape)) if value.ndim >= len(shape) else ["..."]
    validate.floating(name, value, (*leading, *shape))
    validate.finite(name, value)
    return validate.wide(value)
