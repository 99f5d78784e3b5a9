"""Ambient and directional light on both sides of faces, fused; replaces about 50 torch operations of `Light`."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ..warp.launch import array, launch, optional_array
from ..warp.layout import concurrent, group_tasks, images_of, in_any_order
from ..warp.memory import empty, zeros
from ..warp.registration import differentiable, operator, refuse_second
from .corners import CORNER, FACE, gather_corners_backward

# Without fused multiply-adds, the light on both sides is that of opposite normals, exactly.
wp.set_module_options({"enable_backward": False, "fuse_fp": False})

LARGE = 1e4  # faces with larger coordinates are scaled down before their normals are computed
SMALLEST_SINE = 1e-5  # a face with a smaller area, relative to its squared edge length, has a normal shorter than 1
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
        ambient: RGB of the ambient light, [1 or B, 3] float32.
        directional: RGB of the directional light, [1 or B, 3] float32.
        direction: [1 or B, 3] float32, towards the light.
        mirrored: Whether the camera mirrors.

    Returns:
        [B, 2, F, 3] float32. Index 0 is the side of (v1 − v0) × (v2 − v0), or the opposite one if ``mirrored``. NaN for
        an index outside [0, V).
    """
    batch, count = images_of(vertices, faces, ambient, directional, direction), faces.shape[1]
    factors = empty((batch, 2, count, 3), vertices.device)
    groups, each = group_tasks(count, vertices.device, 512)
    arguments = [*_arguments(vertices, faces, ambient, directional, direction, mirrored), groups, each, array(factors)]
    launch(_forward, batch * groups, arguments, vertices.device, _LEAST)
    return factors


@torch.library.register_fake("neural_renderer::flat_light")
def _(vertices, faces, ambient, directional, direction, mirrored):
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
    """Compute the gradients of `flat_light`.

    Returns:
        To the vertices, [1 or B, V, 3]; to the light, [B, 9]: ambient, directional, direction; empty if not
        ``light_too``.
    """
    batch, _, count, _ = grad.shape
    if batch == 0:
        return zeros(vertices.shape, grad.device), grad.new_zeros((0, _SUMS))
    groups, each = group_tasks(count, grad.device, 512, 32 if light_too else 1)
    # On the CPU, one task sums the gradient to faces that images share, image by image.
    own = batch if concurrent(grad.device) else images_of(vertices, faces)
    device, to_vertices, to_corners = grad.device, None, None
    if in_any_order(device):  # tasks add to the vertices at once
        to_vertices = zeros(vertices.shape, device)
    else:
        to_corners = empty((own, count, 3, 3), device)
    sums = torch.empty((batch, groups, _SUMS) if light_too else (0, 0, _SUMS), device=grad.device)
    arguments = [*_arguments(vertices, faces, ambient, directional, direction, mirrored), groups, each, array(grad)]
    arguments += [int(light_too), own, optional_array(to_corners, 4, device)]
    arguments += [optional_array(to_vertices, 3, device), array(sums)]
    launch(_backward, own * groups, arguments, device, max(1, _LEAST * own // max(batch, 1)))
    if to_vertices is not None:
        return to_vertices, sums.sum(1)
    to_vertices = gather_corners_backward(to_corners, faces, vertices.shape[1])
    if own > len(vertices):
        to_vertices = to_vertices.sum(0, keepdim=True)
    return to_vertices, sums.sum(1)


@torch.library.register_fake("neural_renderer::flat_light_backward")
def _(grad, vertices, faces, ambient, directional, direction, mirrored, light_too):
    return vertices.new_empty(vertices.shape), grad.new_empty((len(grad) if light_too else 0, _SUMS))


def _arguments(vertices, faces, ambient, directional, direction, mirrored):
    light = [array(ambient), array(directional), array(direction)]
    return [array(vertices), array(faces), *light, int(mirrored)]


def _save(ctx, inputs, output):
    *tensors, ctx.mirrored = inputs
    ctx.save_for_backward(*tensors)


def _to_inputs(ctx, grad):
    light_too = any(ctx.needs_input_grad[2:5])
    to_vertices, to_light = flat_light_backward(grad, *ctx.saved_tensors, ctx.mirrored, light_too)
    results = [to_vertices, None, None, None, None]
    for k, tensor in enumerate(ctx.saved_tensors[2:], 2):
        if ctx.needs_input_grad[k]:
            own = to_light[:, 3 * k - 6 : 3 * k - 3]
            results[k] = own if len(tensor) == len(own) else own.sum(0, keepdim=True)
    return *results, None


differentiable(flat_light, _to_inputs, _save)


def _save_again(ctx, inputs, output):
    grad, vertices, faces, _, directional, direction, ctx.mirrored, ctx.light_too = inputs
    ctx.save_for_backward(grad, vertices, faces, directional, direction)


def _to_first(ctx, _, light):
    """Differentiate <light, gradient to it>, the change of the factors with the light."""
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


_BEGIN = """
    const int count = vertices.shape[1];
    const wp::int64 all = faces.shape[1];
    const float* points = vertices.data + (b < vertices.shape[0] ? b : vertices.shape[0] - 1) * (wp::int64)count * 3;
    const float* glow = ambient.data + 3 * (b < ambient.shape[0] ? b : ambient.shape[0] - 1);
    const float* beam = directional.data + 3 * (b < directional.shape[0] ? b : directional.shape[0] - 1);
    const float* towards = direction.data + 3 * (b < direction.shape[0] ? b : direction.shape[0] - 1);
"""
# Vectors of faces, whose numbers lie apart, would save little time and take a second to compile.
_LOOP = """
    #if !defined(__CUDA_ARCH__)
    #pragma clang loop vectorize(disable) interleave(disable) unroll(disable)
    #endif
"""
# Normals as `face_normals` computes them, along (v0 - v1) x (v2 - v1).
_NORMAL = f"""
        float largest = 0.0f, v[9], p[3], q[3], n[3], pp = 0.0f, qq = 0.0f;
        {FACE}
        for (int k = 0; k < 3; ++k) {{
            {CORNER}
            for (int c = 0; c < 3; ++c) v[3 * k + c] = valid ? points[3 * (wp::int64)i + c] : NAN;
        }}
        for (int k = 0; k < 9; ++k) {{
            const float size = fabsf(v[k]);
            largest = size > largest ? size : largest;
        }}
        const float scale = largest > {LARGE!r}f ? {LARGE!r}f / largest : 1.0f;
        for (int k = 0; k < 3; ++k) {{
            p[k] = (v[k] - v[3 + k]) * scale, q[k] = (v[6 + k] - v[3 + k]) * scale;
            pp += p[k] * p[k], qq += q[k] * q[k];
        }}
        for (int k = 0; k < 3; ++k) n[k] = p[(k + 1) % 3] * q[(k + 2) % 3] - p[(k + 2) % 3] * q[(k + 1) % 3];
        const float length = sqrtf(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
        float edge = pp > qq ? pp : qq;
        edge = edge > 1.0f ? 1.0f : edge < 1.0e-12f ? 1.0e-12f : edge;
        const float floor = {SMALLEST_SINE!r}f * edge, part = 1.0f / (length > floor ? length : floor);
        for (int k = 0; k < 3; ++k) n[k] *= part;
        const float toward = n[0] * towards[0] + n[1] * towards[1] + n[2] * towards[2];
        const float facing = mirrored ? toward : -toward;  // of side 0
"""


@wp.func_native(f"""
    {_BEGIN}
    float* to = factors.data + b * all * 6;
    {_LOOP}
    for (int f = begin; f < end; ++f) {{
        {_NORMAL}
        const float front = facing > 0.0f ? facing : 0.0f, back = facing < 0.0f ? -facing : 0.0f;
        for (int k = 0; k < 3; ++k) {{
            to[3 * f + k] = glow[k] + beam[k] * front;
            to[3 * (all + f) + k] = glow[k] + beam[k] * back;
        }}
    }}
""")
def light_faces(
    vertices: wp.array3d(dtype=float),
    faces: wp.array3d(dtype=int),
    ambient: wp.array2d(dtype=float),
    directional: wp.array2d(dtype=float),
    direction: wp.array2d(dtype=float),
    mirrored: int,
    b: int,
    begin: int,
    end: int,
    factors: wp.array4d(dtype=float),
):
    """Light the faces [begin, end) in image b."""


@wp.func_native(f"""
    {_BEGIN}
    const float* g = grad.data + b * all * 6;
    float* to = to_corners.data + own * all * 9;
    double sum[9];
    for (int k = 0; k < 9; ++k) sum[k] = 0.0;
    {_LOOP}
    for (int f = begin; f < end; ++f) {{
        {_NORMAL}
        const float *front = g + 3 * f, *back = g + 3 * (all + f);
        const float* lit = facing > 0.0f ? front : back;
        float gain = 0.0f;
        for (int k = 0; k < 3; ++k) {{
            sum[k] += front[k] + back[k];
            sum[3 + k] += lit[k] * fabsf(facing);
            gain += lit[k] * beam[k];
        }}
        // By n . direction: only one side is lit, and none if the light comes along the face.
        gain = facing > 0.0f ? gain : facing < 0.0f ? -gain : 0.0f;
        if (!mirrored) gain = -gain;
        float to_n[3], to_v[9];
        for (int k = 0; k < 3; ++k) sum[6 + k] += gain * n[k], to_n[k] = gain * towards[k];
        const float along = length > floor ? gain * toward : 0.0f;
        for (int k = 0; k < 3; ++k) to_n[k] = (to_n[k] - along * n[k]) * part * scale;
        for (int k = 0; k < 3; ++k) {{
            const int l = (k + 1) % 3, m = (k + 2) % 3;
            to_v[k] = q[l] * to_n[m] - q[m] * to_n[l];
            to_v[6 + k] = to_n[l] * p[m] - to_n[m] * p[l];
            to_v[3 + k] = -to_v[k] - to_v[6 + k];
        }}
        #if defined(__CUDA_ARCH__)
        if (to_vertices.shape[0] > 0) {{
            float* to_points = to_vertices.data + (points - vertices.data);
            for (int k = 0; k < 3; ++k) {{
                {CORNER}
                for (int c = 0; valid && c < 3; ++c) wp::atomic_add(to_points + 3 * (wp::int64)i + c, to_v[3 * k + c]);
            }}
            continue;
        }}
        #endif
        for (int k = 0; k < 9; ++k) to[9 * (wp::int64)f + k] = to_v[k] + (add ? to[9 * (wp::int64)f + k] : 0.0f);
    }}
    float* whole = sums.data + (b * (wp::int64)sums.shape[1] + group) * 9;
    for (int k = 0; k < 9 && light_too; ++k) whole[k] = (float)sum[k];
""")
def unlight_faces(
    vertices: wp.array3d(dtype=float),
    faces: wp.array3d(dtype=int),
    ambient: wp.array2d(dtype=float),
    directional: wp.array2d(dtype=float),
    direction: wp.array2d(dtype=float),
    mirrored: int,
    b: int,
    own: int,
    add: int,
    group: int,
    begin: int,
    end: int,
    grad: wp.array4d(dtype=float),
    light_too: int,
    to_corners: wp.array4d(dtype=float),
    to_vertices: wp.array3d(dtype=float),
    sums: wp.array3d(dtype=float),
):
    """Compute the gradients of the faces [begin, end) in image b: to corners, or added to vertices if there are any.

    Those to corners are accumulated into mesh ``own`` if ``add``.
    """


@wp.kernel
def _forward(
    first: int,
    vertices: wp.array3d(dtype=float),
    faces: wp.array3d(dtype=int),
    ambient: wp.array2d(dtype=float),
    directional: wp.array2d(dtype=float),
    direction: wp.array2d(dtype=float),
    mirrored: int,
    groups: int,
    each: int,
    factors: wp.array4d(dtype=float),
):
    task = first + wp.tid()
    begin = (task % groups) * each
    end = wp.min(begin + each, faces.shape[1])
    light_faces(vertices, faces, ambient, directional, direction, mirrored, task // groups, begin, end, factors)


@wp.kernel
def _backward(
    first: int,
    vertices: wp.array3d(dtype=float),
    faces: wp.array3d(dtype=int),
    ambient: wp.array2d(dtype=float),
    directional: wp.array2d(dtype=float),
    direction: wp.array2d(dtype=float),
    mirrored: int,
    groups: int,
    each: int,
    grad: wp.array4d(dtype=float),
    light_too: int,
    meshes: int,
    to_corners: wp.array4d(dtype=float),
    to_vertices: wp.array3d(dtype=float),
    sums: wp.array3d(dtype=float),
):
    task = first + wp.tid()
    group = task % groups
    own = task // groups
    begin = group * each
    end = wp.min(begin + each, faces.shape[1])
    from_image = own
    to_image = own + 1
    if meshes < grad.shape[0]:
        from_image = 0
        to_image = grad.shape[0]
    for b in range(from_image, to_image):
        add = int(b > from_image)
        unlight_faces(
            vertices, faces, ambient, directional, direction, mirrored, b, own, add, group, begin, end, grad, light_too,
            to_corners, to_vertices, sums,
        )  # fmt: skip
