"""Ambient and directional light on both sides of faces, fused; replaces about 50 torch operations of `Light`."""

# torch reads the annotations of operators at run time, so no `from __future__ import annotations` here.

from typing import Any

import torch
from torch import Tensor

from ..warp.launch import launch
from ..warp.layout import concurrent, group_tasks, images_of, in_any_order
from ..warp.memory import empty, zeros
from ..warp.native import Call, Kernels
from ..warp.registration import differentiable, fake, operator, refuse_second
from .corners import Groups, gather_corners_backward, triangles_of

# Without fused multiply-adds, the light on both sides is that of opposite normals, exactly.
_KERNELS = Kernels(__name__, "flat_light.h", fused=False)
_LitScene, _FlatLight, _FlatLightBackward = map(_KERNELS.struct, ("LitScene", "FlatLight", "FlatLightBackward"))
_light_faces = _KERNELS.kernel("light_faces", _FlatLight)
_light_faces_backward = _KERNELS.kernel("light_faces_backward", _FlatLightBackward)

LARGE = 1e4  # LARGE of flat_light.h
SMALLEST_SINE = 1e-5  # SMALLEST_SINE of flat_light.h
_SUMS = 9  # partial sums of each group of faces: ambient, directional, direction
_LEAST = 16  # groups of faces that are worth another thread


@operator
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


@fake(flat_light)
def _(vertices: Tensor, faces: Tensor, ambient: Tensor, directional: Tensor, direction: Tensor) -> Tensor:
    images = images_of(vertices, faces, ambient, directional, direction)
    return vertices.new_empty((images, 2, faces.shape[1], 3))


@operator
def flat_light_backward(
    grad: Tensor,
    vertices: Tensor,
    faces: Tensor,
    ambient: Tensor,
    directional: Tensor,
    direction: Tensor,
    mirrored: bool,
    light_too: bool,
) -> tuple[Tensor, Tensor]:
    """Compute the gradients of `flat_light` to the vertices, [1 or B, V, 3], and to the light, [B, 9].

    The latter has ambient, directional and direction; it is empty if not ``light_too``.
    """
    batch, _, count, _ = grad.shape
    if batch == 0:
        return zeros(vertices.shape, grad.device), grad.new_zeros((0, _SUMS))
    groups, each = group_tasks(count, grad.device, 512, 32 if light_too else 1)
    # One CPU task sums the gradient to faces that images share, image by image.
    own = batch if concurrent(grad.device) else images_of(vertices, faces)
    device, at_once = grad.device, in_any_order(grad.device)  # tasks add to the vertices at once
    to_vertices = zeros(vertices.shape, device) if at_once else empty((0, 0, 3), device)
    to_corners = None if at_once else empty((own, count, 3, 3), device)
    sums = torch.empty((batch, groups, _SUMS) if light_too else (0, 0, _SUMS), device=grad.device)
    call = _FlatLightBackward(
        scene=_lit_scene(vertices, faces, ambient, directional, direction, mirrored),
        tasks=Groups(groups=groups, each=each),
        grad=grad.contiguous(),
        images=batch,
        targets=own,
        to_corners=to_corners,
        to_vertices=to_vertices if at_once else None,
        sums=sums if light_too else None,
    )
    launch(_light_faces_backward, own * groups, [call], device, max(1, _LEAST * own // max(batch, 1)))
    if to_corners is None:
        return to_vertices, sums.sum(1)
    to_vertices = gather_corners_backward(to_corners, faces, vertices.shape[1])
    if own > len(vertices):
        to_vertices = to_vertices.sum(0, keepdim=True)
    return to_vertices, sums.sum(1)


@fake(flat_light_backward)
def _(grad: Tensor, vertices: Tensor, light_too: bool) -> tuple[Tensor, Tensor]:
    return vertices.new_empty(vertices.shape), grad.new_empty((len(grad) if light_too else 0, _SUMS))


def _lit_scene(
    vertices: Tensor, faces: Tensor, ambient: Tensor, directional: Tensor, direction: Tensor, mirrored: bool
) -> Call:
    return _LitScene(
        triangles=triangles_of(faces, vertices.shape[1]),
        vertices=vertices.contiguous(),
        ambient=ambient.contiguous(),
        directional=directional.contiguous(),
        direction=direction.contiguous(),
        meshes=len(vertices),
        ambients=len(ambient),
        directionals=len(directional),
        directions=len(direction),
        mirrored=int(mirrored),
    )


def _save(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
    *tensors, ctx.mirrored = inputs
    ctx.save_for_backward(*tensors)


def _to_inputs(ctx: Any, grad: Tensor) -> tuple[Any, ...]:
    light_too = any(ctx.needs_input_grad[2:5])
    inputs: list[Any] = [grad, *ctx.saved_tensors, ctx.mirrored, light_too]
    to_vertices, to_light = flat_light_backward(*inputs)
    results: list[Tensor | None] = [to_vertices, None, None, None, None]
    for k, tensor in enumerate(ctx.saved_tensors[2:], 2):
        if ctx.needs_input_grad[k]:
            own = to_light[:, 3 * k - 6 : 3 * k - 3]
            results[k] = own if len(tensor) == len(own) else own.sum(0, keepdim=True)
    return *results, None


differentiable(flat_light, _to_inputs, _save)


def _save_again(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
    grad, vertices, faces, _, directional, direction, ctx.mirrored, ctx.light_too = inputs
    ctx.save_for_backward(grad, vertices, faces, directional, direction)


def _to_first(ctx: Any, _: Tensor, light: Tensor) -> tuple[Any, ...]:
    """Differentiate <light, its gradient>: the change of the factors with the light."""
    if ctx.needs_input_grad[1]:
        refuse_second("flat_light_backward")
    if not ctx.light_too:
        return (None,) * 8
    grad, vertices, faces, directional, direction = ctx.saved_tensors
    glow, beam, towards = (part[:, None, None] for part in light.split(3, 1))
    # Normals of both sides: the light from each axis on the front, less that on the back.
    black, axes = light.new_zeros(1, 3), torch.eye(3, device=light.device)
    with torch.no_grad():
        sides = [flat_light(vertices, faces, black, black + 1, axis[None], ctx.mirrored)[..., 0] for axis in axes]
        normals = torch.stack([side[:, 0] - side[:, 1] for side in sides], -1).nan_to_num(nan=0.0)
        normals = torch.stack((normals, -normals), 1)
    facing = (normals * direction[:, None, None]).sum(-1, keepdim=True)
    change = (normals * towards).sum(-1, keepdim=True) * (facing > 0)
    to_grad = glow + beam * facing.relu() + directional[:, None, None] * change
    to_directional = (grad * change).sum((1, 2)).sum_to_size(directional.shape)
    to_direction = ((grad * beam).sum(-1, keepdim=True) * (facing > 0) * normals).sum((1, 2))
    return to_grad, None, None, None, to_directional, to_direction.sum_to_size(direction.shape), None, None


differentiable(flat_light_backward, _to_first, _save_again)
