"""OpenDR's gradient as an operation on an image: the estimator `gradient="opendr"`, for comparison.

Source: Loper and Black, "OpenDR: An approximate differentiable renderer", ECCV 2014, the section on derivatives by
image-space differences. Each pixel's colour is thought to be carried along by the face that it shows:

    dI = -(dI/dx) * (motion of the face along x) - (dI/dy) * (motion along y),

with the barycentric mean of the motions of the face's corners. The slope dI/dx comes from the two neighbouring pixels:

- Both show the same surface, or both something farther: (-1, 0, 1) / 2. Both show something nearer: 0.
- One shows a farther surface or the background: the difference to this one, since this boundary moves with the face.
- One shows a nearer surface: the difference to the other one, since this boundary does not move with the face.

Two faces count as one surface if the step in depth between the pixels is at most the sum of the steps within both
faces. The paper draws the silhouette edges of the mesh instead; the filters are the same.

So the background has no gradient, and the gradient reaches one pixel far. Faces with a corner behind the camera get
nothing. The code is plain torch, not tuned for speed.
"""

# torch reads the annotations at run time, so no `from __future__ import annotations` here.
from typing import Any, NamedTuple

import torch
from torch import Tensor

from ..colors.downsample import halve, halve_backward
from ..warp.elementwise import copy
from ..warp.registration import differentiable, differentiable_once, fake, operator


@operator
def opendr_gradient(
    image: Tensor, faces: Tensor, face_index: Tensor, perspective: bool, halved: bool = False
) -> Tensor:
    """Return the image and send a gradient to the x and y of faces [B, F, 3, 3], by OpenDR's rule.

    The image [B, C, H, W] has its background; ``halved`` averages blocks of 2 x 2 pixels. Indices [B, H, W] int32 and
    ``perspective`` are as in `coverage`.
    """
    return halve(image) if halved else copy(image)


@fake(opendr_gradient)
def _(image: Tensor, faces: Tensor, face_index: Tensor, perspective: bool, halved: bool = False) -> Tensor:
    scale = 2 if halved else 1
    return image.new_empty((*image.shape[:2], image.shape[2] // scale, image.shape[3] // scale))


@differentiable_once
def opendr_gradient_backward(
    grad: Tensor, image: Tensor, faces: Tensor, face_index: Tensor, perspective: bool
) -> Tensor:
    """Compute the gradient of `opendr_gradient` to faces, [B, F, 3, 3]; the gradient to z is 0."""
    result = torch.zeros_like(faces, memory_format=torch.contiguous_format)
    if result.numel() == 0 or image.numel() == 0:
        return result
    here = _Surface.of(faces, face_index, perspective)
    to_points = []
    for axis, pixels in ((0, image.shape[3]), (1, image.shape[2])):
        slope = _slope(image, here, axis)
        to_points.append(-(grad * slope).sum(1) * pixels / 2)  # gain of a motion by a screen unit
    to_corners = torch.stack(to_points, -1)[..., None, :] * here.weights[..., None].to(image.dtype)  # [B, H, W, 3, 2]
    to_corners = torch.where(here.drawn[..., None, None], to_corners, 0.0)
    place = (
        face_index.clamp(min=0).long() + faces.shape[1] * torch.arange(len(faces), device=faces.device)[:, None, None]
    )
    flat = result.view(-1, 3, 3)
    flat[..., :2] = torch.zeros_like(flat[..., :2]).index_add_(0, place.flatten(), to_corners.flatten(0, 2))
    return result


@fake(opendr_gradient_backward)
def _(grad: Tensor, image: Tensor, faces: Tensor, face_index: Tensor, perspective: bool) -> Tensor:
    return torch.empty_like(faces, memory_format=torch.contiguous_format)


def _save(ctx: Any, inputs: Any, output: Any) -> None:
    image, faces, face_index, ctx.perspective, ctx.halved = inputs
    ctx.save_for_backward(image, faces, face_index)  # not the output, which callers may change in place


def _backward(ctx: Any, grad: Tensor) -> Any:
    image, faces, face_index = ctx.saved_tensors
    grad = halve_backward(grad) if ctx.halved else grad
    to_faces = None
    if ctx.needs_input_grad[1]:
        to_faces = opendr_gradient_backward(grad, image, faces, face_index, ctx.perspective)
    return grad, to_faces, None, None, None


differentiable(opendr_gradient, _backward, _save)


class _Surface(NamedTuple):
    """The visible surface at the centre of each pixel."""

    face_index: Tensor  # [B, H, W]
    drawn: Tensor  # [B, H, W] bool: a face is visible, and all of it is in front of the camera
    weights: Tensor  # [B, H, W, 3] float64, barycentric on the screen
    nearness: Tensor  # [B, H, W] float64: larger in front, linear over a face; -inf for the background
    steps: tuple[Tensor, Tensor]  # changes of the nearness to the next pixel to the right, and up

    @classmethod
    def of(cls, faces: Tensor, face_index: Tensor, perspective: bool) -> "_Surface":
        batch, height, width = face_index.shape
        images = torch.arange(batch, device=faces.device)[:, None, None]
        corners = faces.double()[images, face_index.clamp(min=0).long()]  # [B, H, W, 3, 3]
        x = (2 * torch.arange(width, dtype=torch.float64, device=faces.device) + 1 - width) / width
        y = ((2 * torch.arange(height, dtype=torch.float64, device=faces.device) + 1 - height) / height).flip(0)
        centre = torch.stack(torch.broadcast_tensors(x[None, :], y[:, None]), -1)
        arms = corners[..., :2] - centre[None, :, :, None]
        after, later = arms.roll(-1, -2), arms.roll(-2, -2)
        parts = after[..., 0] * later[..., 1] - after[..., 1] * later[..., 0]
        area = parts.sum(-1, keepdim=True)
        side = (after - later) / area[..., None]  # opposite edge of each corner, over the area
        # A motion of the centre along x changes a corner's weight by the y of the opposite edge, and vice versa.
        to_right, up = side[..., 1] * 2 / width, -side[..., 0] * 2 / height
        z = corners[..., 2]
        values = 1 / z if perspective else -z
        drawn = (face_index >= 0) & (area[..., 0] != 0)
        if perspective:
            drawn = drawn & (z > 0).all(-1)
        nearness = torch.where(drawn, (parts / area * values).sum(-1), -torch.inf)
        steps = [torch.where(drawn, (change * values).sum(-1), 0.0) for change in (to_right, up)]
        return cls(face_index, drawn, parts / area, nearness, (steps[0], steps[1]))


def _slope(image: Tensor, here: _Surface, axis: int) -> Tensor:
    """Compute the slope of an image by pixel, along x to the right (axis 0) or along y upwards (axis 1)."""
    along, sign = (-1, 1) if axis == 0 else (-2, -1)  # rows are stored from the top
    difference = image.diff(dim=along) * sign  # difference of the pixels n and n + 1
    steps = here.steps[axis].abs()
    first, second = (_part(here.nearness, along, n) for n in (0, 1))
    most = _part(steps, along, 0) + _part(steps, along, 1)
    same = _part(here.face_index, along, 0) == _part(here.face_index, along, 1)
    rounding = 1e-6 * torch.maximum(first.abs(), second.abs())
    both = first.isfinite() & second.isfinite()
    same = same | (both & ((first - second).abs() <= most + rounding))
    slope = torch.zeros_like(image)
    # The pair behind each pixel, and the pair before it: usable as a moving boundary, or as one surface.
    boundary = _beside(~same & (second > first), ~same & (first > second), along)
    inside = _beside(same, same, along)
    any_boundary = boundary[0] | boundary[1]
    for n in (0, 1):
        use = torch.where(any_boundary, boundary[n], inside[n])
        other = torch.where(any_boundary, boundary[1 - n], inside[1 - n])
        weight = torch.where(use, torch.where(other, 0.5, 1.0), 0.0).to(image.dtype)
        padded = torch.nn.functional.pad(difference, _pads(along, n))
        slope = slope + weight[:, None] * padded
    return slope


def _part(values: Tensor, along: int, n: int) -> Tensor:
    """Take the first (n = 0) or the second pixel of each pair."""
    return values.narrow(along, n, values.shape[along] - 1)


def _pads(along: int, n: int) -> tuple[int, ...]:
    """Return pads that place pairs at their second pixel (n = 0) or at their first one."""
    pads = (1, 0) if n == 0 else (0, 1)
    return pads if along == -1 else (0, 0, *pads)


def _beside(before: Tensor, behind: Tensor, along: int) -> tuple[Tensor, Tensor]:
    """Give each pixel a flag of the pair that it ends, and of the pair that it starts; False beyond the border."""
    return tuple(torch.nn.functional.pad(flag, _pads(along, n)) for n, flag in ((0, before), (1, behind)))  # type: ignore[return-value]
