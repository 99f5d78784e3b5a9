"""Where the camera stands: world coordinates to camera coordinates (x, y across the view, z along it)."""

from __future__ import annotations

import math
from numbers import Real
from typing import Any

import torch
from torch import Tensor

from .. import validate
from .parameters import Array, batch_of, batch_size, common_device, float_type, parameter

_FLOOR = 1e-5  # lengths below it count as zero, as in the published code
_LARGE = 1e4  # coordinates up to which lengths are computed as they are


def look_at(vertices: Tensor, eye: Array, at: Array | None = None, up: Array | None = None) -> Tensor:
    """World vertices seen by a camera at ``eye`` that looks at the point ``at``.

    The axes are z = norm(at − eye), x = norm(up × z), y = norm(z × x), as in the published `neural_renderer`: the
    world is taken as left-handed, so a model of the usual, right-handed kind appears mirrored. `Camera.look_at` does
    not mirror.

    Args:
        vertices: [B, V, 3] or [V, 3], floating.
        eye: the camera's position, [3] or [B, 3]: list, tuple, array or tensor.
        at: the point looked at, likewise; None is the origin.
        up: the direction that is up in the picture, likewise, of any length; None is +y.

    Returns:
        Camera coordinates [B, V, 3] (one mesh and a batch of eyes give that batch), or [V, 3] if nothing has a batch;
        z is the distance along the viewing direction in world units. Differentiable in all arguments.

    Raises:
        TypeError, ValueError: wrong types or shapes; and, if values are checked, a number that is not finite,
            ``eye`` equal to ``at``, or ``up`` parallel to the viewing direction.
    """
    dtype = validate.vertices(vertices).dtype
    rotation, origin = look_at_frame(eye, (0, 0, 0) if at is None else at, (0, 1, 0) if up is None else up, dtype)
    return transform(vertices, rotation, origin)


def look(vertices: Tensor, eye: Array, direction: Array | None = None, up: Array | None = None) -> Tensor:
    """World vertices seen by a camera at ``eye`` that looks along ``direction`` (None is +z).

    Everything else is as in `look_at`, the handedness too.
    """
    dtype = validate.vertices(vertices).dtype
    forward = (0, 0, 1) if direction is None else direction
    rotation, origin = look_frame(eye, forward, (0, 1, 0) if up is None else up, dtype)
    return transform(vertices, rotation, origin)


def look_at_frame(eye: Array, at: Array, up: Array, dtype: torch.dtype, mirrored: bool = True) -> tuple[Tensor, Tensor]:
    """The camera of `look_at` as its axes, the rows of [3, 3] or [B, 3, 3], and its position [3] or [B, 3].

    ``mirrored`` is the left-handed view of the old functions; without it x = norm(z × up) points to the right of
    somebody who stands in a right-handed world.
    """
    eye, at, up = _vectors(dtype, eye=eye, at=at, up=up)
    problem = "eye: expected a point away from `at`, got the same point"
    return _axes(at - eye, up, mirrored, problem), eye


def look_frame(
    eye: Array, direction: Array, up: Array, dtype: torch.dtype, mirrored: bool = True
) -> tuple[Tensor, Tensor]:
    """The camera of `look`, as `look_at_frame` returns it."""
    eye, direction, up = _vectors(dtype, eye=eye, direction=direction, up=up)
    return _axes(direction, up, mirrored, "direction: expected a vector, got one of no length"), eye


def transform(vertices: Tensor, rotation: Tensor, origin: Tensor) -> Tensor:
    """rotation · (X − origin) for all X of vertices [V, 3] or [B, V, 3]; the others on any device, of any dtype."""
    if not vertices.is_meta:
        validate.has_numbers("camera", rotation)
    rotation, origin = rotation.to(vertices), origin.to(vertices)
    batch_size(vertices=batch_of(vertices, 2), camera=max(batch_of(rotation, 2), batch_of(origin, 1)))
    return rotate(rotation, vertices - origin[..., None, :])


def rotate(matrix: Tensor, points: Tensor) -> Tensor:
    """Each matrix [3, 3] or [B, 3, 3] times its points [V, 3] or [B, V, 3]."""
    # Not matmul: under autocast or with TF32 allowed it would round coordinates to 10 bits.
    columns = matrix[..., None, :, :]
    x, y, z = points[..., 0:1], points[..., 1:2], points[..., 2:3]
    return x * columns[..., 0] + y * columns[..., 1] + z * columns[..., 2]


def get_points_from_angles(distance: Any, elevation: Any, azimuth: Any, degrees: bool = True) -> Any:
    """Points around the origin: (d·cos e·sin a, d·sin e, −d·cos e·cos a), so that azimuth 0 is on the −z axis.

    Args:
        distance: from the origin, in world units.
        elevation: above the xz plane; 90° is +y.
        azimuth: about the y axis; 90° is +x.
        degrees: whether the two angles are in degrees (else radians).

    Returns:
        Three Python numbers give a tuple of three floats. If any argument is a tensor, an array or a list, all are
        broadcast, and a tensor [B, 3] comes back, differentiable, of the tensors' dtype and on their device.

    Raises:
        TypeError: an argument that is not numbers. ValueError: shapes that do not broadcast; numbers that are not
            finite (a tensor's only if values are checked).
    """
    values = {"distance": distance, "elevation": elevation, "azimuth": azimuth}
    if all(isinstance(v, Real) for v in values.values()):
        distance, elevation, azimuth = (validate.number(name, v) for name, v in values.items())
        if degrees:
            elevation, azimuth = math.radians(elevation), math.radians(azimuth)
        across = distance * math.cos(elevation)
        return across * math.sin(azimuth), distance * math.sin(elevation), -across * math.cos(azimuth)
    dtype, device = float_type(*values.values()), common_device(*values.values())
    tensors = [parameter(name, v, (), dtype, device) for name, v in values.items()]
    batch_size(**{name: batch_of(t, 0) for name, t in zip(values, tensors, strict=True)})
    d, e, a = torch.broadcast_tensors(*tensors)
    if degrees:
        e, a = torch.deg2rad(e), torch.deg2rad(a)
    return torch.stack((d * e.cos() * a.sin(), d * e.sin(), -d * e.cos() * a.cos()), dim=-1)


def _vectors(dtype: torch.dtype, **values: Any) -> list[Tensor]:
    device = common_device(*values.values())
    vectors = [parameter(name, v, (3,), dtype, device) for name, v in values.items()]
    batch_size(**{name: batch_of(v, 1) for name, v in zip(values, vectors, strict=True)})
    return vectors


def _axes(forward: Tensor, up: Tensor, mirrored: bool, problem: str) -> Tensor:
    z = _normalized(forward)
    side = torch.linalg.cross(*torch.broadcast_tensors(_normalized(up), z), dim=-1)
    if validate.values_are_checked(side):
        if not bool((forward.detach().norm(dim=-1) >= _FLOOR).all()):
            raise ValueError(problem)
        if not bool((side.detach().norm(dim=-1) >= _FLOOR).all()):
            raise ValueError("up: expected a vector across the viewing direction, got one along it or of no length")
    x = _normalized(side)
    y = _normalized(torch.linalg.cross(*torch.broadcast_tensors(z, x), dim=-1))
    return torch.stack(torch.broadcast_tensors(x if mirrored else -x, y, z), dim=-2)


def _normalized(vectors: Tensor) -> Tensor:
    """Vectors [..., 3] over their lengths, or over `_FLOOR` where they are shorter.

    As `torch.nn.functional.normalize`, but the same to the bit for one vector and for it among others, and for vectors
    whose squares overflow.
    """
    largest = vectors.detach().abs().amax(-1, keepdim=True)
    v = validate.wide(vectors / (largest / _LARGE).clamp(min=1))
    x, y, z = v[..., :1], v[..., 1:2], v[..., 2:]
    return (v / (x * x + y * y + z * z).clamp(min=_FLOOR**2).sqrt()).to(vectors.dtype)
