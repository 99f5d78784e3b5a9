"""Colour from the cube of texels that each face owns, and the light that falls on the face."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ..warp.geometry import facing, in_front, pixel_box
from ..warp.launch import array, face_lanes, launch, zeros
from ..warp.registration import differentiable_once, operator
from .visible_faces import next_shown, seen_faces

wp.set_module_options({"enable_backward": False})


@operator
def sample_textures(
    textures: Tensor,
    light: Tensor,
    background: Tensor,
    faces: Tensor,
    face_index: Tensor,
    weights: Tensor,
    eps: float,
    perspective: bool,
) -> Tensor:
    """The colour [B, 3, H, W] of each pixel; differentiable in textures, light, background and weights.

    textures: [B or 1, F, T, T, T, 3] float32; texel [a][b][c] belongs to corner weights (0, 1, 2) in that order.
    light: [B or 1, 2, F, 3] factors on the side that is seen when the corners run counter-clockwise, and on the other.
    background: [B, 3, H, W], seen where no face is.
    faces, face_index, weights: as `coverage` and `barycentrics` take and give them.
    eps: cube coordinates end at T - 1 - eps.

    The coordinate along corner k's axis is T - 1 times its weight, and the 8 texels around it are blended. With T = 1
    the face has one colour.
    """
    batch, height, width = face_index.shape
    color = torch.empty((batch, 3, height, width), dtype=torch.float32, device=faces.device)
    arguments = _arguments(textures, light, faces, face_index, weights, eps, perspective)
    launch(_forward, batch * height, [*arguments, array(background, strided=True), array(color)], faces.device)
    return color


@torch.library.register_fake("neural_renderer::sample_textures")
def _(textures, light, background, faces, face_index, weights, eps, perspective):  # type: ignore[no-untyped-def]
    batch, height, width = face_index.shape
    return faces.new_empty((batch, 3, height, width))


@differentiable_once
def sample_textures_backward(
    grad: Tensor,
    textures: Tensor,
    light: Tensor,
    faces: Tensor,
    face_index: Tensor,
    weights: Tensor,
    eps: float,
    perspective: bool,
    light_too: bool,
    weights_too: bool,
) -> tuple[Tensor, Tensor, Tensor]:
    """The gradients of `sample_textures` to textures, light (zero if not ``light_too``) and weights (likewise)."""
    batch, height, width = face_index.shape
    lanes = face_lanes(faces, height * width)
    # A face's only task clears its cubes itself, which spares the memory one pass.
    to_textures = torch.empty(textures.shape, dtype=torch.float32, device=faces.device)
    if lanes > 1:
        to_textures.zero_()
    to_light = zeros((batch, *light.shape[1:]), faces.device)
    arguments = _arguments(textures, light, faces, face_index, weights, eps, perspective)
    to_weights = zeros(weights.shape if weights_too else (0, 0, 0, 3), faces.device)
    results = [
        array(to_textures.view(*textures.shape[:2], textures.shape[2] ** 3, 3), wp.vec3),
        array(to_light, wp.vec3),
        array(to_weights, wp.vec3),
    ]
    # Textures that images share belong to one task, which takes the images in turn.
    images = 1 if textures.shape[0] < batch else batch
    tasks = images * faces.shape[1] * lanes
    seen = array(seen_faces(face_index, faces.shape[1]))
    launch(
        _backward,
        tasks,
        [*arguments, array(grad), seen, int(light_too), int(weights_too), images, lanes, *results],
        faces.device,
    )
    return to_textures, to_light.sum(0, keepdim=True) if light.shape[0] < batch else to_light, to_weights


@torch.library.register_fake("neural_renderer::sample_textures_backward")
def _(grad, textures, light, faces, face_index, weights, eps, perspective, light_too, weights_too):  # type: ignore[no-untyped-def]
    to_weights = weights.new_empty(weights.shape if weights_too else (0, 0, 0, 3))
    return textures.new_empty(textures.shape), light.new_empty(light.shape), to_weights


def _arguments(textures, light, faces, face_index, weights, eps, perspective):  # type: ignore[no-untyped-def]
    cubes = array(textures.reshape(*textures.shape[:2], textures.shape[2] ** 3, 3), wp.vec3)
    maps = [array(face_index), array(weights, wp.vec3)]
    return [
        cubes,
        array(light, wp.vec3),
        array(faces, wp.vec3),
        *maps,
        textures.shape[2],
        eps,
        int(perspective),
    ]


def _save(ctx, inputs, output):  # type: ignore[no-untyped-def]
    textures, light, _, faces, face_index, weights, ctx.eps, ctx.perspective = inputs
    ctx.save_for_backward(textures, light, faces, face_index, weights)


def _to_inputs(ctx, grad):  # type: ignore[no-untyped-def]
    to_textures = to_light = to_background = to_weights = None
    textures_too, light_too, weights_too = (ctx.needs_input_grad[k] for k in (0, 1, 5))
    if textures_too or light_too or weights_too:
        to_textures, to_light, to_weights = sample_textures_backward(
            grad, *ctx.saved_tensors, ctx.eps, ctx.perspective, light_too, weights_too
        )
    if ctx.needs_input_grad[2]:
        to_background = grad * (ctx.saved_tensors[3] < 0)[:, None]
    weights_gradient = to_weights if weights_too else None
    return to_textures, to_light, to_background, None, None, weights_gradient, None, None


torch.library.register_autograd("neural_renderer::sample_textures", _to_inputs, setup_context=_save)


@wp.func
def cube_coordinate(w: wp.vec3, size: int, eps: float) -> wp.vec3:
    top = float(size - 1)
    c = top * w
    for k in range(3):
        c[k] = wp.clamp(c[k], 0.0, top - eps)
    return c


# The 8 texels around a cube coordinate and their shares, in plain C++: compilers keep this loop in registers. A cube of
# one texel has no neighbours to blend.
_TEXELS = """
    if (size == 1) { ONE }
    const int low[3] = {(int)c[0], (int)c[1], (int)c[2]};
    const float up[3] = {c[0] - (float)low[0], c[1] - (float)low[1], c[2] - (float)low[2]};
    const wp::int64 first = ((cube * size + low[0]) * size + low[1]) * size + low[2];
    wp::vec_t<3, float> sum(0.0f);
    for (int corner = 0; corner < 8; ++corner) {
        const int i = corner >> 2, j = (corner >> 1) & 1, k = corner & 1;
        const float share = (i ? up[0] : 1.0f - up[0]) * (j ? up[1] : 1.0f - up[1]) * (k ? up[2] : 1.0f - up[2]);
        const wp::int64 texel = first + (i * size + j) * size + k;
        DO
    }
"""


@wp.func_native(
    _TEXELS.replace("ONE", "return textures.data[cube];").replace("DO", "sum += share * textures.data[texel];")
    + "    return sum;"
)
def blend(textures: wp.array3d(dtype=wp.vec3), cube: wp.int64, size: int, c: wp.vec3) -> wp.vec3:
    """The colour at a coordinate of the cube of that number."""
    ...


_SLOPE = """
        const float gain = wp::dot(textures.data[texel], part);
        sum[0] += (i ? gain : -gain) * (j ? up[1] : 1.0f - up[1]) * (k ? up[2] : 1.0f - up[2]);
        sum[1] += (j ? gain : -gain) * (i ? up[0] : 1.0f - up[0]) * (k ? up[2] : 1.0f - up[2]);
        sum[2] += (k ? gain : -gain) * (i ? up[0] : 1.0f - up[0]) * (j ? up[1] : 1.0f - up[1]);
"""


@wp.func_native(_TEXELS.replace("ONE", "return wp::vec_t<3, float>(0.0f);").replace("DO", _SLOPE) + "    return sum;")
def slope(textures: wp.array3d(dtype=wp.vec3), cube: wp.int64, size: int, c: wp.vec3, part: wp.vec3) -> wp.vec3:
    """What the colour there, weighted with ``part``, gains along each axis of the cube."""
    ...


@wp.func_native(
    _TEXELS.replace("ONE", "wp::atomic_add(&textures.data[cube], part); return;").replace(
        "DO", "wp::atomic_add(&textures.data[texel], share * part);"
    )
)
def scatter(textures: wp.array3d(dtype=wp.vec3), cube: wp.int64, size: int, c: wp.vec3, part: wp.vec3):
    """Its transpose: add ``part`` to the texels, each its share."""
    ...


@wp.func_native("""
    const wp::int64 texels = (wp::int64)size * size * size;
    memset(textures.data + cube * texels, 0, texels * sizeof(wp::vec_t<3, float>));
""")
def clear(textures: wp.array3d(dtype=wp.vec3), cube: wp.int64, size: int):
    """Set the cube of that number to zero."""
    ...


@wp.func
def side_seen(v0: wp.vec3, v1: wp.vec3, v2: wp.vec3, perspective: int) -> int:
    if facing(v0, v1, v2, perspective) < 0:
        return 1
    return 0


@wp.kernel
def _forward(
    first: int,
    textures: wp.array3d(dtype=wp.vec3),
    light: wp.array3d(dtype=wp.vec3),
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    weights: wp.array3d(dtype=wp.vec3),
    size: int,
    eps: float,
    perspective: int,
    background: wp.array4d(dtype=float),
    color: wp.array4d(dtype=float),
):
    task = first + wp.tid()
    height = face_index.shape[1]
    b = task // height
    row = task % height
    last = int(-1)
    factor = wp.vec3(0.0, 0.0, 0.0)
    cubes = wp.int64(wp.min(b, textures.shape[0] - 1)) * wp.int64(textures.shape[1])
    for i in range(face_index.shape[2]):
        f = face_index[b, row, i]
        if f < 0:
            for c in range(3):
                color[b, c, row, i] = background[b, c, row, i]
        else:
            if f != last:  # neighbours mostly show the same face
                last = f
                v0 = faces[b, f, 0]
                v1 = faces[b, f, 1]
                v2 = faces[b, f, 2]
                factor = light[wp.min(b, light.shape[0] - 1), side_seen(v0, v1, v2, perspective), f]
            at = cube_coordinate(weights[b, row, i], size, eps)
            lit = wp.cw_mul(blend(textures, cubes + wp.int64(f), size, at), factor)
            for c in range(3):
                color[b, c, row, i] = lit[c]


@wp.kernel
def _backward(
    first: int,
    textures: wp.array3d(dtype=wp.vec3),
    light: wp.array3d(dtype=wp.vec3),
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    weights: wp.array3d(dtype=wp.vec3),
    size: int,
    eps: float,
    perspective: int,
    grad: wp.array4d(dtype=float),
    seen: wp.array2d(dtype=int),
    light_too: int,
    weights_too: int,
    images: int,
    lanes: int,
    to_textures: wp.array3d(dtype=wp.vec3),
    to_light: wp.array3d(dtype=wp.vec3),
    to_weights: wp.array3d(dtype=wp.vec3),
):
    """One face, of one image or of all, over the pixels that show it; with several lanes, each takes some rows."""
    task = first + wp.tid()
    lane = task % lanes
    f = (task // lanes) % faces.shape[1]
    own = (task // lanes) // faces.shape[1]
    height = face_index.shape[1]
    width = face_index.shape[2]
    cube = wp.int64(own) * wp.int64(faces.shape[1]) + wp.int64(f)
    from_image = own
    to_image = own + 1
    if lanes == 1:
        clear(to_textures, cube, size)
    if images == 1:
        from_image = 0
        to_image = faces.shape[0]
    for b in range(from_image, to_image):
        if seen[b, f] == 0:
            continue
        v0 = faces[b, f, 0]
        v1 = faces[b, f, 1]
        v2 = faces[b, f, 2]
        front = in_front(v0, v1, v2, perspective)
        if front < 0:
            continue
        side = side_seen(v0, v1, v2, perspective)
        factor = light[wp.min(b, light.shape[0] - 1), side, f]
        lit = wp.vec3(0.0, 0.0, 0.0)
        box = pixel_box(v0, v1, v2, front, height, width)
        for j in range(box[2] + lane, box[3] + 1, lanes):
            row = height - 1 - j
            line = wp.int64(b) * wp.int64(height) + wp.int64(row)
            i = next_shown(face_index, line, width, box[0], box[1] + 1, f)
            while i <= box[1]:
                g = wp.vec3(grad[b, 0, row, i], grad[b, 1, row, i], grad[b, 2, row, i])
                c = cube_coordinate(weights[b, row, i], size, eps)
                scatter(to_textures, cube, size, c, wp.cw_mul(g, factor))
                if light_too == 1:
                    lit += wp.cw_mul(blend(textures, cube, size, c), g)
                if weights_too == 1:
                    to_weight = float(size - 1) * slope(textures, cube, size, c, wp.cw_mul(g, factor))
                    raw = float(size - 1) * weights[b, row, i]
                    for k in range(3):
                        to_weights[b, row, i][k] = wp.where(raw[k] == c[k], to_weight[k], 0.0)
                i = next_shown(face_index, line, width, i + 1, box[1] + 1, f)
        wp.atomic_add(to_light, b, side, f, lit)
