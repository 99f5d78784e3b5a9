"""View transform: world coordinates to camera coordinates (x, y across the view, z along it)."""

from __future__ import annotations

import math
from numbers import Real
from typing import Any

import torch
from torch import Tensor

from ..base import validate
from ..base.constants import on_device
from ..raster.ops.project_corners import rotate
from .parameters import Array, batch_of, batch_size, common_device, float_type, parameter

_FLOOR = 1e-5  # sine of the angle between `up` and the viewing direction below which they count as parallel
_SMALL, _LARGE = 1e-3, 1e4  # vectors of other sizes are scaled before their length is computed
_TINY = 1e-30  # vectors of smaller coordinates count as zero
_SAME = 8  # distance of two points, in steps of their largest coordinate, below which they are equal


def look_at(vertices: Tensor, eye: Array, at: Array | None = None, up: Array | None = None) -> Tensor:
    """Transform world vertices to the coordinates of a camera at ``eye`` that looks at the point ``at``.

    The axes are z = norm(at − eye), x = norm(up × z), y = norm(z × x), as in the published `neural_renderer`. They suit
    a left-handed world, so models in right-handed coordinates appear mirrored. `Camera.look_at` does not mirror.

    Args:
        vertices: [V, 3] or [B, V, 3] floating.
        eye, at, up: As in `Camera.look_at`; None means the origin and +y.

    Returns:
        Camera coordinates [B, V, 3], or [V, 3] if no argument has a batch. One mesh and B eyes give a batch of B. z is
        the distance along the viewing direction in world units. Differentiable in all arguments.

    Raises:
        TypeError, ValueError: A type or shape does not fit, ``eye`` equals ``at``, or ``up`` is parallel to the viewing
            direction (see `check_values`).

    Example:
        >>> nr.look_at(torch.zeros(1, 3), eye=(0.0, 0.0, -2.5))
        tensor([[0.0000, 0.0000, 2.5000]])
    """
    dtype = validate.vertices(vertices).dtype
    rotation, origin = look_at_frame(eye, (0, 0, 0) if at is None else at, (0, 1, 0) if up is None else up, dtype)
    return transform(vertices, rotation, origin)


def look(vertices: Tensor, eye: Array, direction: Array | None = None, up: Array | None = None) -> Tensor:
    """Transform world vertices to the coordinates of a camera at ``eye`` that looks along ``direction``.

    Args:
        vertices, eye, up: As in `look_at`.
        direction: Viewing direction, [3] or [B, 3], of any length; None means +z.

    Returns:
        Camera coordinates in the same left-handed axes as `look_at`.

    Raises:
        TypeError, ValueError: As `look_at`, or ``direction`` is 0.

    Example:
        >>> nr.look(torch.zeros(1, 3), eye=(0.0, 0.0, -2.5), direction=(0.0, 0.0, 1.0))
        tensor([[0.0000, 0.0000, 2.5000]])
    """
    dtype = validate.vertices(vertices).dtype
    forward = (0, 0, 1) if direction is None else direction
    rotation, origin = look_frame(eye, forward, (0, 1, 0) if up is None else up, dtype)
    return transform(vertices, rotation, origin)


def look_at_frame(eye: Array, at: Array, up: Array, dtype: torch.dtype, mirrored: bool = True) -> tuple[Tensor, Tensor]:
    """Compute the axes of `look_at`, as rows of [3, 3] or [B, 3, 3], and the camera's position [3] or [B, 3].

    Unless ``mirrored``, x = norm(z × up) points to the right of a viewer in a right-handed world.
    """
    given = (each.dtype for each in (eye, at) if isinstance(each, Tensor) and each.is_floating_point())
    rounding = max(torch.finfo(each).eps for each in (dtype, *given))
    eye, at, up = _vectors(dtype, eye=eye, at=at, up=up)
    problem = "eye: expected a point away from `at`, got the same point"
    largest = torch.maximum(*torch.broadcast_tensors(eye.detach().abs(), at.detach().abs())).amax(-1)
    least = _TINY + _SAME * rounding * largest
    return _axes(at - eye, up, mirrored, problem, least), eye


def look_frame(
    eye: Array, direction: Array, up: Array, dtype: torch.dtype, mirrored: bool = True
) -> tuple[Tensor, Tensor]:
    """Compute the axes and position of `look`; see `look_at_frame`."""
    eye, direction, up = _vectors(dtype, eye=eye, direction=direction, up=up)
    problem = "direction: expected a vector of positive length, got one of length 0"
    return _axes(direction, up, mirrored, problem), eye


def eye_position(rotation: Tensor, origin: Tensor, translation: Tensor) -> Tensor:
    """Compute the centre of projection, [B, 3]: X with rotation · (X − origin) + translation = 0."""
    # A sum of products, since matmul rounds under autocast.
    return origin - (rotation * translation[:, :, None]).sum(1)


def transform(vertices: Tensor, rotation: Tensor, origin: Tensor) -> Tensor:
    """Compute rotation · (X − origin) for vertices X, [V, 3] or [B, V, 3], on their device."""
    if not vertices.is_meta:
        validate.has_numbers("camera", rotation)
    rotation, origin = on_device(rotation, vertices), on_device(origin, vertices)
    batch_size(vertices=batch_of(vertices, 2), camera=max(batch_of(rotation, 2), batch_of(origin, 1)))
    return rotate(rotation, vertices - origin[..., None, :])


def get_points_from_angles(distance: Any, elevation: Any, azimuth: Any, degrees: bool = True) -> Any:
    """Convert spherical to Cartesian coordinates: (d·cos e·sin a, d·sin e, −d·cos e·cos a).

    Args:
        distance: Distance d from the origin, in world units.
        elevation: Angle e above the xz plane; 90° is +y.
        azimuth: Angle a around the y axis; 0° is −z, 90° is +x.
        degrees: Whether the angles are in degrees; otherwise they are in radians.

    Returns:
        A tuple of three floats for numbers. If an argument is a tensor, an array or a list, all are broadcast to a
        tensor [B, 3], differentiable, of the tensors' dtype and on their device.

    Raises:
        TypeError: An argument does not hold numbers.
        ValueError: Shapes do not broadcast, or a number is not finite (tensors: while values are checked).

    Example:
        >>> nr.get_points_from_angles(2.0, torch.tensor([0.0, 30.0]), 45.0)
        tensor([[ 1.4142,  0.0000, -1.4142],
                [ 1.2247,  1.0000, -1.2247]])
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
    """Convert vectors, given by argument name, to tensors [3] or [B, 3] with batches that fit."""
    device = common_device(*values.values())
    # `Camera.origin` returns the eye to users, so it must not be a shared constant.
    vectors = [parameter(name, v, (3,), dtype, device, shared=name != "eye") for name, v in values.items()]
    batch_size(**{name: batch_of(v, 1) for name, v in zip(values, vectors, strict=True)})
    return vectors


def _axes(forward: Tensor, up: Tensor, mirrored: bool, problem: str, least: Tensor | float = _TINY) -> Tensor:
    """Compute the camera's axes as rows; ValueError with ``problem`` if ``forward`` has no coordinate above a least."""
    z = _normalized(forward)
    side = torch.linalg.cross(*torch.broadcast_tensors(_normalized(up), z), dim=-1)
    if validate.values_are_checked(side):
        if not bool((forward.detach().abs().amax(-1) > least).all()):
            raise ValueError(problem)
        if not bool((side.detach().norm(dim=-1) >= _FLOOR).all()):
            raise ValueError("up: expected a vector not parallel to the viewing direction, got a parallel or zero one")
    x = _normalized(side)
    y = _normalized(torch.linalg.cross(*torch.broadcast_tensors(z, x), dim=-1))
    return torch.stack(torch.broadcast_tensors(x if mirrored else -x, y, z), dim=-2)


def _normalized(vectors: Tensor) -> Tensor:
    """Divide vectors [..., 3] by their lengths; zeros stay.

    Unlike `torch.nn.functional.normalize`, results are bitwise independent of the rest of the batch, and vectors of any
    size neither overflow nor vanish.
    """
    wide = validate.wide(vectors)
    largest = wide.detach().abs().amax(-1, keepdim=True)
    small = torch.where(largest > _TINY, largest / _SMALL, 1).clamp(max=1)
    size = small * (largest / _LARGE).clamp(min=1)
    v = wide / (size / torch.frexp(size).mantissa)  # a power of two, by which the division is exact
    x, y, z = v[..., :1], v[..., 1:2], v[..., 2:]
    return (v / (x * x + y * y + z * z).clamp(min=_FLOOR**2).sqrt()).to(vectors.dtype)
