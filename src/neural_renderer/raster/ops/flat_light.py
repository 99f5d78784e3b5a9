"""Ambient and directional light on both sides of faces, fused; replaces about 50 torch operations of `Light`."""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.

from collections.abc import Sequence
from typing import Any, Optional

import torch
from torch import Tensor

from ..warp import registration
from ..warp.launch import launch
from ..warp.layout import concurrent, group_tasks, images_of, in_any_order
from ..warp.memory import empty, zeros
from ..warp.native import Call, Kernels, constant
from .corners import Groups, gather_corners, gather_corners_backward, triangles_of

# Without fused multiply-adds, the light on both sides is that of opposite normals, exactly.
_KERNELS = Kernels(__name__, "flat_light.h", fused=False)
_LitScene, _FlatLight, _FlatLightBackward = map(_KERNELS.struct, ("LitScene", "FlatLight", "FlatLightBackward"))
_light_faces = _KERNELS.kernel("light_faces", _FlatLight)
_light_faces_backward = _KERNELS.kernel("light_faces_backward", _FlatLightBackward)

LARGEST_COORDINATE = constant("flat_light.h", "LARGEST_COORDINATE", float)
SMALLEST_SINE = constant("flat_light.h", "SMALLEST_SINE", float)
_SUMS = constant("flat_light.h", "LIGHT_SUMS")
_LEAST = 16  # groups of faces that justify another thread


@registration.operator
def flat_light(
    vertices: Tensor, faces: Tensor, ambient: Tensor, directional: Tensor, direction: Tensor, mirrored: bool
) -> Tensor:
    """Compute ambient + directional · max(n · direction, 0) for both normals n of each face; differentiable in all.

    Args:
        vertices: [1 or B, V, 3] float32, in world space.
        faces: Vertex indices, [1 or B, F, 3] int32, as of `gather_corners`.
        ambient, directional: RGB of the ambient and of the directional light, [1 or B, 3] float32.
        direction: [1 or B, 3] float32, towards the light.

    Returns:
        [B, 2, F, 3] float32. Index 0 is the side of (v1 − v0) × (v2 − v0), or the opposite one if the camera is
        ``mirrored``. NaN for an index outside [0, V).
    """
    batch, count = images_of(vertices, faces, ambient, directional, direction), faces.shape[1]
    factors = empty((batch, 2, count, 3), vertices.device)
    groups, each = group_tasks(count, vertices.device, 512)
    scene = _lit_scene(vertices, faces, ambient, directional, direction, mirrored)
    call = _FlatLight(scene=scene, tasks=Groups(groups=groups, each=each), factors=factors)
    launch(_light_faces, batch * groups, [call], vertices.device, _LEAST)
    return factors


@registration.fake(flat_light)
def _(vertices: Tensor, faces: Tensor, ambient: Tensor, directional: Tensor, direction: Tensor) -> Tensor:
    images = images_of(vertices, faces, ambient, directional, direction)
    return vertices.new_empty((images, 2, faces.shape[1], 3))


@registration.gradient_of(flat_light)
def flat_light_backward(grad: Tensor, light_too: bool, *inputs: Any) -> tuple[Tensor, Tensor]:
    """Compute the gradients of `flat_light` to the vertices, [1 or B, V, 3], and to the light, [B, 9].

    The latter has ambient, directional and direction; it is empty if not ``light_too``.
    """
    vertices, faces, *_ = inputs
    batch, _, count, _ = grad.shape
    if batch == 0:
        return zeros(vertices.shape, grad.device), grad.new_zeros((0, _SUMS))
    groups, each = group_tasks(count, grad.device, 512, 32 if light_too else 1)
    # One CPU task sums the gradient to faces that images share, image by image.
    targets = batch if concurrent(grad.device) else images_of(vertices, faces)
    device, atomic = grad.device, in_any_order(grad.device)  # tasks add to the vertices concurrently
    to_vertices = zeros(vertices.shape, device) if atomic else empty((0, 0, 3), device)
    to_corners = None if atomic else empty((targets, count, 3, 3), device)
    sums = torch.empty((batch, groups, _SUMS) if light_too else (0, 0, _SUMS), device=grad.device)
    call = _FlatLightBackward(
        scene=_lit_scene(*inputs),
        tasks=Groups(groups=groups, each=each),
        grad=grad,
        images=batch,
        targets=targets,
        to_corners=to_corners,
        to_vertices=to_vertices if atomic else None,
        sums=sums if light_too else None,
    )
    launch(_light_faces_backward, targets * groups, [call], device, max(1, _LEAST * targets // max(batch, 1)))
    if to_corners is None:
        return to_vertices, sums.sum(1)
    to_vertices = gather_corners_backward(to_corners, faces, vertices.shape[1])
    if targets > len(vertices):
        to_vertices = to_vertices.sum(0, keepdim=True)
    return to_vertices, sums.sum(1)


@registration.fake(flat_light_backward)
def _(grad: Tensor, vertices: Tensor, light_too: bool) -> tuple[Tensor, Tensor]:
    return vertices.new_empty(vertices.shape), grad.new_empty((len(grad) if light_too else 0, _SUMS))


@registration.forward_operator(4, flat_light)
def flat_light_forward(
    to_vertices: Optional[Tensor],  # noqa: UP045 (schemas are inferred from it)
    to_ambient: Optional[Tensor],  # noqa: UP045
    to_directional: Optional[Tensor],  # noqa: UP045
    to_direction: Optional[Tensor],  # noqa: UP045
    *inputs: Any,
) -> Tensor:
    """Compute the tangent [T, B, 2, F, 3] of `flat_light` for tangents of its inputs, each [T, ...] or None for 0."""
    vertices, faces, ambient, directional, direction, mirrored = inputs
    black = torch.zeros_like(ambient)
    parts = []
    if to_ambient is not None:
        parts.append(to_ambient[:, :, None, None])
    if to_directional is not None:
        unit = flat_light(vertices, faces, black, torch.ones_like(directional), direction, mirrored)
        parts.append(unit * to_directional[:, :, None, None])
    if to_vertices is not None or to_direction is not None:
        normals, towards = _normals(vertices, faces, mirrored), direction[:, None]
        change = (
            0.0
            if to_vertices is None
            else (_normal_tangents(vertices, faces, normals, to_vertices, mirrored) * towards).sum(-1)
        )
        if to_direction is not None:
            change = change + (normals * to_direction[:, :, None]).sum(-1)
        facing = (normals * towards).sum(-1)
        both = torch.stack((change * (facing > 0), -change * (facing < 0)), 2)
        parts.append(both[..., None] * directional[:, None, None])
    result = registration.sum_of(parts)
    given = next(each for each in (to_vertices, to_ambient, to_directional, to_direction) if each is not None)
    shape = (len(given), images_of(vertices, faces, ambient, directional, direction), 2, faces.shape[1], 3)
    return vertices.new_zeros(shape) if result is None else result.expand(shape).contiguous()


def _normals(vertices: Tensor, faces: Tensor, mirrored: bool) -> Tensor:
    """Compute the normals [B, F, 3] of side 0: the light from each axis on the front, minus that on the back."""
    black, axes = vertices.new_zeros(1, 3), torch.eye(3, device=vertices.device)
    with torch.no_grad():
        sides = [flat_light(vertices, faces, black, black + 1, axis[None], mirrored)[..., 0] for axis in axes]
    return torch.stack([side[:, 0] - side[:, 1] for side in sides], -1).nan_to_num(nan=0.0)


def _normal_tangents(vertices: Tensor, faces: Tensor, normals: Tensor, motion: Tensor, mirrored: bool) -> Tensor:
    """Compute the tangents of the normals, [T, B, F, 3], for tangents of the vertices, [T, 1 or B, V, 3]."""
    images = images_of(vertices, faces)
    corners = gather_corners(vertices.expand(images, -1, -1), faces)
    several = faces if len(faces) == 1 else faces.repeat(len(motion), 1, 1)
    moved = gather_corners(motion.expand(-1, images, -1, -1).flatten(0, 1), several).unflatten(0, (-1, images))
    scale = (LARGEST_COORDINATE / corners.abs().amax((-2, -1), keepdim=True)).clamp(max=1.0)
    (p, q), (to_p, to_q) = _arms(corners * scale), _arms(moved * scale)
    length = torch.linalg.vector_norm(torch.linalg.cross(p, q), dim=-1, keepdim=True)
    longest = torch.maximum(p.square().sum(-1, keepdim=True), q.square().sum(-1, keepdim=True))
    floor = SMALLEST_SINE * longest.clamp(1e-12, 1.0)
    change_of_cross = torch.linalg.cross(to_p, q[None]) + torch.linalg.cross(p[None], to_q)
    change = change_of_cross / torch.maximum(length, floor) * (1.0 if mirrored else -1.0)
    # Unit normals change orthogonally to themselves. Those of slivers are shorter, so their length changes, too.
    return change - torch.where(length > floor, (normals * change).sum(-1, keepdim=True), 0.0) * normals


def _arms(corners: Tensor) -> tuple[Tensor, Tensor]:
    """Compute the edges from the second corner of faces, [..., 3, 3], to the first and to the third."""
    return corners[..., 0, :] - corners[..., 1, :], corners[..., 2, :] - corners[..., 1, :]


def _lit_scene(*inputs: Any) -> Call:
    """Make the `LitScene` of kernels from the inputs of `flat_light`."""
    vertices, faces, ambient, directional, direction, mirrored = inputs
    return _LitScene(
        triangles=triangles_of(faces, vertices.shape[1]),
        vertices=vertices,
        ambient=ambient,
        directional=directional,
        direction=direction,
        meshes=vertices.shape[0],
        ambients=ambient.shape[0],
        directionals=directional.shape[0],
        directions=direction.shape[0],
        mirrored=mirrored,
    )


def _to_inputs(ctx: Any, grad: Tensor) -> Any:
    inputs, light_too = registration.saved_inputs(ctx), any(ctx.needs_input_grad[2:5])
    to_vertices, to_light = flat_light_backward(grad, light_too, *inputs)
    found = {"vertices": to_vertices}
    if not light_too:
        return found
    parts = zip(("ambient", "directional", "direction"), inputs[2:5], to_light.split(3, 1), strict=True)
    return found | {
        name: total if len(given) == len(total) else total.sum(0, keepdim=True) for name, given, total in parts
    }


def _forward(inputs: Sequence[Any], tangents: Sequence[Any]) -> Any:
    to_vertices, _, *to_light = tangents[:5]
    return registration.in_direction(flat_light_forward, (to_vertices, *to_light), *inputs)


registration.differentiable(flat_light, _to_inputs, registration.save_inputs, _forward)


def _to_first(ctx: Any, _: Tensor, light: Tensor) -> Any:
    """Differentiate <light, its gradient>: the change of the factors with the light."""
    grad, light_too, vertices, faces, _, directional, direction, mirrored = registration.saved_inputs(ctx)
    if ctx.needs_input_grad[2]:
        registration.refuse_second("flat_light_backward")
    if not light_too:
        return {}
    glow, beam, towards = (part[:, None, None] for part in light.split(3, 1))
    normals = _normals(vertices, faces, mirrored)
    normals = torch.stack((normals, -normals), 1)  # of both sides
    facing = (normals * direction[:, None, None]).sum(-1, keepdim=True)
    change = (normals * towards).sum(-1, keepdim=True) * (facing > 0)
    to_grad = glow + beam * facing.relu() + directional[:, None, None] * change
    to_directional = (grad * change).sum((1, 2)).sum_to_size(directional.shape)
    to_direction = ((grad * beam).sum(-1, keepdim=True) * (facing > 0) * normals).sum((1, 2))
    to_direction = to_direction.sum_to_size(direction.shape)
    return {"grad": to_grad, "directional": to_directional, "direction": to_direction}


registration.differentiable(flat_light_backward, _to_first, registration.save_inputs)
