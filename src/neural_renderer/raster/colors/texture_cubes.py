"""Texture cubes: the colour of each pixel from the cube of texels of its face, under light."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ..ops.visible_faces import box_of_face, end_of_run, pixels_of_run, visible_faces
from ..warp.launch import array, launch, module_for_cuda
from ..warp.layout import face_tasks, in_any_order, pixel_tasks, run_tasks, worth_a_thread
from ..warp.memory import empty, zeros
from ..warp.point import over_face, over_rows
from ..warp.registration import differentiable, operator, refuse_second
from .cube import CUBE

# No fused multiply-adds, as in `barycentrics`, so that the weights are bitwise equal.
wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@operator
def sample_textures(
    textures: Tensor,
    light: Tensor,
    background: Tensor,
    faces: Tensor,
    face_index: Tensor,
    eps: float,
    perspective: bool,
) -> Tensor:
    """Sample texture cubes; differentiable in textures, light, background and faces.

    The coordinate along the axis of corner k is T - 1 times its weight; the 8 texels around it are blended. With T = 1
    a face has one colour. The gradient to faces comes from the colours inside them, through the weights.

    Args:
        textures: Cubes, [B or 1, F, T, T, T, 3] float32; texel [a][b][c] belongs to corner weights (0, 1, 2).
        light: Factors on the front and the back of each face, [B or 1, 2, F, 3] float32. On the front, corners run
            counter-clockwise.
        background: [B, 3, H, W] float32, for pixels without a face.
        faces: As in `barycentrics`.
        face_index: As in `barycentrics`.
        eps: Cube coordinates end at T - 1 - eps.
        perspective: As in `barycentrics`.

    Returns:
        [B, 3, H, W] float32.
    """
    batch, height, width = face_index.shape
    color = empty((batch, 3, height, width), faces.device)
    arguments = _arguments(textures, light, faces, face_index, eps, perspective)
    tasks, each = pixel_tasks(batch * height, width, faces.device)
    arguments += [array(background, strided=True), each, array(color)]
    launch(_forward, tasks, arguments, faces.device, worth_a_thread(each * width))
    return color


@torch.library.register_fake("neural_renderer::sample_textures")
def _(textures, light, background, faces, face_index, eps, perspective):
    batch, height, width = face_index.shape
    return faces.new_empty((batch, 3, height, width))


@operator
def sample_textures_backward(
    grad: Tensor,
    textures: Tensor,
    light: Tensor,
    faces: Tensor,
    face_index: Tensor,
    eps: float,
    perspective: bool,
    light_too: bool,
    faces_too: bool,
) -> tuple[Tensor, Tensor, Tensor]:
    """Compute the gradients of `sample_textures` to textures, light (0 if not ``light_too``) and faces.

    The gradient to faces is empty if not ``faces_too``.
    """
    batch, height, width = face_index.shape
    concurrently = in_any_order(faces.device)
    # The task of a face clears its own cubes, which saves a pass over the memory.
    to_textures = empty(textures.shape, faces.device)
    if concurrently or batch == 0:
        to_textures.zero_()
    to_light = zeros((batch, *light.shape[1:]), faces.device)
    to_faces = zeros(faces.shape if faces_too else (0, 0, 3, 3), faces.device)
    arguments = _arguments(textures, light, faces, face_index, eps, perspective)
    results = [
        array(to_textures.view(*textures.shape[:2], textures.shape[2] ** 3, 3), wp.vec3),
        array(to_light, wp.vec3),
        array(to_faces, wp.vec3),
    ]
    arguments += [array(grad), int(light_too), int(faces_too), *results]
    if concurrently:
        tasks, run = run_tasks(batch * height, width)
        launch(_backward_runs, tasks, [*arguments, run], faces.device)
    else:
        # One task sums the gradient to textures that images share, image by image.
        images = 1 if textures.shape[0] < batch else batch
        arguments += [array(visible_faces(face_index, faces.shape[1])), images]
        launch(_backward, images * faces.shape[1], arguments, faces.device, face_tasks(faces, height * width))
    return to_textures, to_light.sum(0, keepdim=True) if light.shape[0] < batch else to_light, to_faces


@torch.library.register_fake("neural_renderer::sample_textures_backward")
def _(grad, textures, light, faces, face_index, eps, perspective, light_too, faces_too):
    to_faces = faces.new_empty(faces.shape if faces_too else (0, 0, 3, 3))
    return textures.new_empty(textures.shape), light.new_empty(light.shape), to_faces


def _arguments(textures, light, faces, face_index, eps, perspective):
    cubes = array(textures.reshape(*textures.shape[:2], textures.shape[2] ** 3, 3), wp.vec3)
    maps = [array(light, wp.vec3), array(faces, wp.vec3), array(face_index)]
    return [cubes, *maps, textures.shape[2], eps, int(perspective)]


def _save(ctx, inputs, output):
    textures, light, _, faces, face_index, ctx.eps, ctx.perspective = inputs
    ctx.save_for_backward(textures, light, faces, face_index)


def _to_inputs(ctx, grad):
    to_textures = to_light = to_background = to_faces = None
    textures_too, light_too, faces_too = (ctx.needs_input_grad[k] for k in (0, 1, 3))
    if textures_too or light_too or faces_too:
        to_textures, to_light, to_faces = sample_textures_backward(
            grad, *ctx.saved_tensors, ctx.eps, ctx.perspective, light_too, faces_too
        )
    if ctx.needs_input_grad[2]:
        to_background = grad * (ctx.saved_tensors[3] < 0)[:, None]
    return to_textures, to_light, to_background, to_faces if faces_too else None, None, None, None


differentiable(sample_textures, _to_inputs, _save)


def _save_again(ctx, inputs, output):
    grad, textures, light, faces, face_index, ctx.eps, ctx.perspective, ctx.light_too, _ = inputs
    ctx.save_for_backward(grad, textures, light, faces, face_index)


def _to_first(ctx, textures, light, _):
    """Differentiate <textures, gradient to them> + <light, gradient to it>, of colours linear in each of both."""
    if ctx.needs_input_grad[3]:
        refuse_second("sample_textures_backward")
    grad, own_textures, own_light, faces, face_index = ctx.saved_tensors
    options = (faces, face_index, ctx.eps, ctx.perspective)
    black = grad.new_zeros(()).expand(grad.shape)
    to_grad = sample_textures(textures, own_light, black, *options)
    to_textures = to_light = None
    if ctx.light_too:
        to_grad = to_grad + sample_textures(own_textures, light, black, *options)
        to_textures, _, _ = sample_textures_backward(grad, own_textures, light, *options, False, False)
        _, to_light, _ = sample_textures_backward(grad, textures, own_light, *options, True, False)
    return to_grad, to_textures, to_light, *[None] * 6


differentiable(sample_textures_backward, _to_first, _save_again)


_BEGIN = """
    const wp::int64 texels = (wp::int64)size * size * size, area = (wp::int64)height * width;
    const wp::int64 cubes = textures.shape[0], lamps = light.shape[0];
    wp::vec_t<3, float> factors[KEPT];
"""
_FRESH = """
                const wp::int64 lamp = b < lamps ? b : lamps - 1;
                factors[slot] = light.data[(2 * lamp + Side::of(face.v, perspective)) * count + f];
"""
_SHOWN = """
            const auto* cube = textures.data + ((b < cubes ? b : cubes - 1) * count + f) * texels;
            const wp::vec_t<3, float> mixed = Cube(weights, size, eps).blend(cube);
            float* to = color.data + pixel + 2 * b * area;
            for (int c = 0; c < 3; ++c) to[c * area] = mixed[c] * factors[slot][c];
"""
_RUN = """
                    const auto* cube = textures.data + ((b < cubes ? b : cubes - 1) * count + f) * texels;
                    float* to = color.data + pixel + 2 * b * area;
                    Eight::floats mixed[3];
                    if (size <= 2) CubeOfEight(eight.weights, size, eps).blend(cube, mixed);
                    else {
                        for (int n = 0; n < run; ++n) {
                            const wp::vec_t<3, float> w(eight.weights[0][n], eight.weights[1][n], eight.weights[2][n]);
                            const wp::vec_t<3, float> one = Cube(w, size, eps).blend(cube);
                            for (int c = 0; c < 3; ++c) mixed[c][n] = one[c];
                        }
                    }
                    for (int c = 0; c < 3; ++c, to += area) {
                        mixed[c] *= factors[slot][c];
                        if (i + 8 <= width) memcpy(to, &mixed[c], sizeof(mixed[c]));
                        else for (int n = 0; n < run; ++n) to[n] = mixed[c][n];
                    }
"""
_EMPTY = """
                const int* step = background.strides;
                const char* behind = (const char*)background.data + b * (wp::int64)step[0]
                    + (row % height) * (wp::int64)step[2] + i * (wp::int64)step[3];
                for (int c = 0; c < 3; ++c, behind += step[1]) {
                    float* to = color.data + pixel + (2 * b + c) * area;
                    if (step[3] == 0) for (int n = 0; n < empty; ++n) to[n] = *(const float*)behind;
                    else for (int n = 0; n < empty; ++n) to[n] = *(const float*)(behind + n * (wp::int64)step[3]);
                }
"""


@wp.func_native(over_rows(_SHOWN, _RUN, _EMPTY, _BEGIN, _FRESH, structs=CUBE))
def color_rows(
    textures: wp.array3d(dtype=wp.vec3),
    light: wp.array3d(dtype=wp.vec3),
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    size: int,
    eps: float,
    perspective: int,
    background: wp.array4d(dtype=float),
    color: wp.array4d(dtype=float),
    task: int,
    each: int,
):
    """Colour the pixels of a task."""
    ...


@wp.kernel
def _forward(
    first: int,
    textures: wp.array3d(dtype=wp.vec3),
    light: wp.array3d(dtype=wp.vec3),
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    size: int,
    eps: float,
    perspective: int,
    background: wp.array4d(dtype=float),
    each: int,
    color: wp.array4d(dtype=float),
):
    color_rows(textures, light, faces, face_index, size, eps, perspective, background, color, first + wp.tid(), each)


@wp.func_native("""
    const wp::int64 texels = (wp::int64)size * size * size;
    memset(textures.data + cube * texels, 0, texels * sizeof(wp::vec_t<3, float>));
""")
def clear(textures: wp.array3d(dtype=wp.vec3), cube: wp.int64, size: int):
    """Set one cube, counted over all images, to zero."""
    ...


_SUM = over_face(
    structs=CUBE,
    begin="""
    const wp::int64 texels = (wp::int64)size * size * size, area = (wp::int64)height * width;
    const auto* cube = textures.data + (own * count + f) * texels;
    auto* to_cube = to_textures.data + (own * count + f) * texels;
    const int side = Side::of(face.v, perspective);
    const wp::int64 lamp = b < light.shape[0] ? b : light.shape[0] - 1;
    const wp::vec_t<3, float> factor = light.data[(2 * lamp + side) * count + f];
    wp::vec_t<3, float> lit(0.0f), g;
    const float* grads = grad.data + 2 * b * area;  // of the first channel, less a row's place
    """,
    one="""
            const Cube at(weights, size, eps);
            for (int c = 0; c < 3; ++c) g[c] = grads[c * area + row + i];
            if (light_too) lit += wp::cw_mul(at.blend(cube), g);
            g = wp::cw_mul(g, factor);
            at.scatter(to_cube, g, alone);
            if (faces_too) face.pull(at.slope(cube, g), 0.0f, weights, on_screen, whole, z);
    """,
    fits="size <= 2",
    eight_begin="""
        wp::vec_t<3, float> lit_cube[8];
        for (int n = 0; n < texels; ++n) lit_cube[n] = wp::cw_mul(cube[n], factor);
        CubeOfEight::Sums sums;
    """,
    eight="""
                const CubeOfEight inside(eight.weights, size, eps);
                Eight::floats pull[3], to_weights[3];
                for (int c = 0; c < 3; ++c) {
                    memcpy(&pull[c], grads + c * area + row + at, sizeof(pull[c]));
                    pull[c] = here ? pull[c] : Eight::none();
                }
                inside.scatter(sums, pull);
                if (faces_too) {
                    inside.slope(lit_cube, pull, to_weights);
                    eight.pull(face, to_weights, Eight::none(), here);
                }
    """,
    eight_end="""
            for (int n = 0; n < texels; ++n) {
                const wp::vec_t<3, float> sum = sums.of(n);
                lit += wp::cw_mul(cube[n], sum);
                to_cube[n] += wp::cw_mul(sum, factor);
            }
    """,
    end="if (light_too) wp::atomic_add(to_light.data + (2 * b + side) * count + f, lit);",
)


@wp.func_native(_SUM)
def uncolor_face(
    textures: wp.array3d(dtype=wp.vec3),
    own: int,
    light: wp.array3d(dtype=wp.vec3),
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    size: int,
    eps: float,
    perspective: int,
    grad: wp.array4d(dtype=float),
    light_too: int,
    faces_too: int,
    b: int,
    f: int,
    left: int,
    right: int,
    bottom: int,
    top: int,
    alone: int,
    to_textures: wp.array3d(dtype=wp.vec3),
    to_light: wp.array3d(dtype=wp.vec3),
    to_faces: wp.array3d(dtype=wp.vec3),
):
    """Sum the gradients of a face's pixels in a box; ``own``: the image of its cubes.

    ``alone``: no other task writes what this one does.
    """
    ...


@wp.kernel
def _backward(
    first: int,
    textures: wp.array3d(dtype=wp.vec3),
    light: wp.array3d(dtype=wp.vec3),
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    size: int,
    eps: float,
    perspective: int,
    grad: wp.array4d(dtype=float),
    light_too: int,
    faces_too: int,
    to_textures: wp.array3d(dtype=wp.vec3),
    to_light: wp.array3d(dtype=wp.vec3),
    to_faces: wp.array3d(dtype=wp.vec3),
    visible: wp.array2d(dtype=int),
    images: int,
):
    """Visit the pixels that show one face, in one image or in all."""
    task = first + wp.tid()
    f = task % faces.shape[1]
    own = task // faces.shape[1]
    from_image = own
    to_image = own + 1
    clear(to_textures, wp.int64(own) * wp.int64(faces.shape[1]) + wp.int64(f), size)
    if images == 1:
        from_image = 0
        to_image = faces.shape[0]
    for b in range(from_image, to_image):
        if visible[b, f] == 0:
            continue
        box = box_of_face(faces, face_index, b, f, perspective)
        if box[0] <= box[1]:
            uncolor_face(
                textures, own, light, faces, face_index, size, eps, perspective, grad, light_too, faces_too, b, f,
                box[0], box[1], box[2], box[3], 1, to_textures, to_light, to_faces,
            )  # fmt: skip


@wp.kernel(module=module_for_cuda(__name__))
def _backward_runs(
    first: int,
    textures: wp.array3d(dtype=wp.vec3),
    light: wp.array3d(dtype=wp.vec3),
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    size: int,
    eps: float,
    perspective: int,
    grad: wp.array4d(dtype=float),
    light_too: int,
    faces_too: int,
    to_textures: wp.array3d(dtype=wp.vec3),
    to_light: wp.array3d(dtype=wp.vec3),
    to_faces: wp.array3d(dtype=wp.vec3),
    run: int,
):
    """Add the gradients of a few neighbouring pixels, face by face, on CUDA."""
    task = first + wp.tid()
    row, i, end = pixels_of_run(face_index, task, run)
    height = int(face_index.shape[1])
    b = row // height
    j = height - 1 - row % height
    while i < end:
        f = face_index[b, row % height, i]
        stop = end_of_run(face_index, wp.int64(row), i, end)
        if f >= 0:
            own = wp.min(b, textures.shape[0] - 1)
            uncolor_face(
                textures, own, light, faces, face_index, size, eps, perspective, grad, light_too, faces_too, b, f, i,
                stop - 1, j, j, 0, to_textures, to_light, to_faces,
            )  # fmt: skip
        i = stop
