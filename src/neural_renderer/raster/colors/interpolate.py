"""Interpolation of corner attributes at every pixel."""

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

# No fused multiply-adds, as in `barycentrics`, so that the weights are bitwise equal.
wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@operator
def interpolate(attributes: Tensor, faces: Tensor, face_index: Tensor, perspective: bool) -> Tensor:
    """Interpolate attributes by the barycentric weights of each pixel; differentiable in attributes and faces.

    The weights of `barycentrics` are computed again, here and in the backward pass; storing them would be slower.

    Args:
        attributes: Values at the corners, [B or 1, F, 3, C] float32.
        faces: As in `barycentrics`.
        face_index: As in `barycentrics`.
        perspective: As in `barycentrics`.

    Returns:
        [B, H, W, C] float32; 0 where no face is visible.
    """
    batch, height, width = face_index.shape
    result = empty((batch, height, width, attributes.shape[3]), faces.device)
    tasks, each = pixel_tasks(batch * height, width, faces.device)
    arguments = [array(attributes), array(faces, wp.vec3), array(face_index), int(perspective), each, array(result)]
    launch(_forward, tasks, arguments, faces.device, worth_a_thread(each * width))
    return result


@torch.library.register_fake("neural_renderer::interpolate")
def _(attributes, faces, face_index, perspective):
    return faces.new_empty((*face_index.shape, attributes.shape[3]))


@operator
def interpolate_backward(
    grad: Tensor, attributes: Tensor, faces: Tensor, face_index: Tensor, perspective: bool, faces_too: bool
) -> tuple[Tensor, Tensor]:
    """Compute the gradients of `interpolate` to attributes and to faces, [B, F, 3, 3]; empty if not ``faces_too``."""
    batch, height, width = face_index.shape
    count = faces.shape[1]
    to_attributes = zeros(attributes.shape, faces.device)
    to_faces = zeros(faces.shape if faces_too else (0, 0, 3, 3), faces.device)
    arguments = [array(attributes), array(faces, wp.vec3), array(face_index), array(grad), int(perspective)]
    arguments += [int(faces_too), array(to_attributes), array(to_faces, wp.vec3)]
    if in_any_order(faces.device):
        tasks, run = run_tasks(batch * height, width)
        launch(_backward_runs, tasks, [*arguments, run], faces.device)
    else:
        # One task sums the gradient to attributes that images share, image by image.
        images = 1 if attributes.shape[0] < batch else batch
        arguments += [array(visible_faces(face_index, count)), images]
        launch(_backward, images * count, arguments, faces.device, face_tasks(faces, height * width))
    return to_attributes, to_faces


@torch.library.register_fake("neural_renderer::interpolate_backward")
def _(grad, attributes, faces, face_index, perspective, faces_too):
    return attributes.new_empty(attributes.shape), faces.new_empty(faces.shape if faces_too else (0, 0, 3, 3))


def _save(ctx, inputs, output):
    *tensors, ctx.perspective = inputs
    ctx.save_for_backward(*tensors)


def _to_inputs(ctx, grad):
    faces_too = ctx.needs_input_grad[1]
    to_attributes, to_faces = interpolate_backward(grad, *ctx.saved_tensors, ctx.perspective, faces_too)
    return to_attributes, to_faces if faces_too else None, None, None


differentiable(interpolate, _to_inputs, _save)


def _save_again(ctx, inputs, output):
    _, _, faces, face_index, ctx.perspective, _ = inputs
    ctx.save_for_backward(faces, face_index)


def _to_gradient(ctx, attributes, _):
    # The gradient to attributes is the transpose of the interpolation, so that its own gradient interpolates.
    if ctx.needs_input_grad[2]:
        refuse_second("interpolate_backward")
    return interpolate(attributes, *ctx.saved_tensors, ctx.perspective), *[None] * 5


differentiable(interpolate_backward, _to_gradient, _save_again)


_BEGIN = "const int channels = attributes.shape[3];"
_FROM = """
            const wp::int64 images = attributes.shape[0];
            const float* from = attributes.data + ((b < images ? b : images - 1) * count + f) * 3 * channels;
            float* to = result.data + pixel * channels;
"""
_SHOWN = (
    _FROM
    + """
            for (int c = 0; c < channels; ++c)
                to[c] = weights[0] * from[c] + weights[1] * from[channels + c] + weights[2] * from[2 * channels + c];
"""
)
# Three channels, the usual number, are stored at once.
_RUN = (
    _FROM
    + """
            const auto mixed = [&](int c, int channels) {
                return eight.weights[0] * from[c] + eight.weights[1] * from[channels + c]
                    + eight.weights[2] * from[2 * channels + c];
            };
            if (channels == 3 && i + 8 <= width) Eight::store(to, mixed(0, 3), mixed(1, 3), mixed(2, 3));
            else {
                for (int c = 0; c < channels; ++c) {
                    float values[8];
                    const Eight::floats channel = mixed(c, channels);
                    memcpy(values, &channel, sizeof(values));
                    for (int n = 0; n < run; ++n) to[n * channels + c] = values[n];
                }
            }
"""
)
_EMPTY = "memset(result.data + pixel * channels, 0, (wp::int64)empty * channels * sizeof(float));"


@wp.func_native(over_rows(_SHOWN, _RUN, _EMPTY, _BEGIN))
def mix_rows(
    attributes: wp.array4d(dtype=float),
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    perspective: int,
    result: wp.array4d(dtype=float),
    task: int,
    each: int,
):
    """Interpolate at the pixels of a task."""
    ...


@wp.kernel
def _forward(
    first: int,
    attributes: wp.array4d(dtype=float),
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    perspective: int,
    each: int,
    result: wp.array4d(dtype=float),
):
    mix_rows(attributes, faces, face_index, perspective, result, first + wp.tid(), each)


_UNMIX = over_face(
    begin="""
    const int channels = attributes.shape[3];
    const float* from = attributes.data + (own * count + f) * 3 * channels;
    float* to_own = to_attributes.data + (own * count + f) * 3 * channels;
    """,
    one="""
            const float* pull = grad.data + (row + i) * channels;
            wp::vec_t<3, float> to_weights(0.0f);
            for (int k = 0; k < 3; ++k)
                for (int c = 0; c < channels; ++c) {
                    to_weights[k] += from[k * channels + c] * pull[c];
                    if (alone) to_own[k * channels + c] += weights[k] * pull[c];
                    else wp::atomic_add(&to_own[k * channels + c], weights[k] * pull[c]);
                }
            if (faces_too) face.pull(to_weights, 0.0f, weights, on_screen, whole, z);
    """,
    fits="channels <= 8",
    # The same as `Face::pull`, but summed first. The gradients of weights are products of ``from`` and ``pull``. So the
    # sums of ``weights[k] * pull`` suffice for the corners, and in perspective those of ``weights[k] * color * pull``.
    eight_begin="""
        Eight::floats sums[3 * 8], sums_of_color[3] = {Eight::none(), Eight::none(), Eight::none()};
        for (int k = 0; k < 3 * channels; ++k) sums[k] = Eight::none();
        float beside[3 * 8];  // less the first corner: a shift of all corners moves nothing
        for (int k = 0; k < 3; ++k)
            for (int c = 0; c < channels; ++c) beside[k * channels + c] = from[k * channels + c] - from[c];
        const bool colors_too = faces_too && perspective;
    """,
    eight="""
                const float* g = grad.data + (row + at) * channels;
                __builtin_prefetch(g - 2 * width * channels);  // two rows up: memory is slower than the sums
                Eight::floats pulls[8], color = Eight::none();
                if (channels == 3) Eight::load(g, pulls);
                else for (int c = 0; c < channels; ++c, ++g)
                    pulls[c] = Eight::floats{g[0], g[channels], g[2 * channels], g[3 * channels], g[4 * channels],
                                             g[5 * channels], g[6 * channels], g[7 * channels]};
                const auto add = [&](int c, int channels) {
                    const Eight::floats pull = here ? pulls[c] : Eight::none();
                    for (int k = 0; k < 3; ++k) sums[3 * c + k] += eight.weights[k] * pull;
                    if (colors_too)
                        color += pull * (eight.weights[1] * beside[channels + c]
                                         + eight.weights[2] * beside[2 * channels + c]);
                };
                if (channels == 3) add(0, 3), add(1, 3), add(2, 3);
                else for (int c = 0; c < channels; ++c) add(c, channels);
                if (colors_too)
                    for (int k = 0; k < 3; ++k) sums_of_color[k] += eight.weights[k] * color;
    """,
    eight_end="""
            float total[3 * 8];
            for (int c = 0; c < channels; ++c)
                for (int k = 0; k < 3; ++k)
                    to_own[k * channels + c] += total[k * channels + c] = Eight::sum(sums[3 * c + k]);
    """,
    give="""
                float right[8], up[8], all_right = 0.0f, all_up = 0.0f;  // slopes of the channels, of 1
                for (int c = 0; c < channels; ++c) right[c] = up[c] = 0.0f;
                for (int k = 0; k < 3; ++k) {
                    const float dx = face.inverse[k] * face.dx[k], dy = face.inverse[k] * face.dy[k];
                    all_right += dx, all_up += dy;
                    for (int c = 0; c < channels; ++c)
                        right[c] += beside[k * channels + c] * dx, up[c] += beside[k * channels + c] * dy;
                }
                for (int k = 0; k < 3; ++k) {
                    const float of_color = Eight::sum(sums_of_color[k]), z = perspective ? face.v[k][2] : 1.0f;
                    float to_x = -all_right * of_color, to_y = -all_up * of_color, to_near = -of_color;
                    for (int c = 0; c < channels; ++c) {
                        const float part = total[k * channels + c];
                        to_x += right[c] * part, to_y += up[c] * part, to_near += beside[k * channels + c] * part;
                    }
                    face.to[3 * k] = -to_x * z;
                    face.to[3 * k + 1] = -to_y * z;
                    face.to[3 * k + 2] = perspective ? -to_near * face.inverse[k] : 0.0f;
                }
    """,
)


@wp.func_native(_UNMIX)
def unmix_face(
    attributes: wp.array4d(dtype=float),
    own: int,
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    grad: wp.array4d(dtype=float),
    perspective: int,
    faces_too: int,
    b: int,
    f: int,
    left: int,
    right: int,
    bottom: int,
    top: int,
    alone: int,
    to_attributes: wp.array4d(dtype=float),
    to_faces: wp.array3d(dtype=wp.vec3),
):
    """Sum the gradients of a face's pixels in a box.

    ``own`` is the index of the image in ``attributes``; ``alone`` means that no other task writes to the same places.
    """
    ...


@wp.kernel
def _backward(
    first: int,
    attributes: wp.array4d(dtype=float),
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    grad: wp.array4d(dtype=float),
    perspective: int,
    faces_too: int,
    to_attributes: wp.array4d(dtype=float),
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
    if images == 1:
        from_image = 0
        to_image = faces.shape[0]
    for b in range(from_image, to_image):
        if visible[b, f] == 0:
            continue
        box = box_of_face(faces, face_index, b, f, perspective)
        if box[0] <= box[1]:
            unmix_face(
                attributes, own, faces, face_index, grad, perspective, faces_too, b, f, box[0], box[1], box[2], box[3],
                1, to_attributes, to_faces,
            )  # fmt: skip


@wp.kernel(module=module_for_cuda(__name__))
def _backward_runs(
    first: int,
    attributes: wp.array4d(dtype=float),
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    grad: wp.array4d(dtype=float),
    perspective: int,
    faces_too: int,
    to_attributes: wp.array4d(dtype=float),
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
            own = wp.min(b, attributes.shape[0] - 1)
            unmix_face(
                attributes, own, faces, face_index, grad, perspective, faces_too, b, f, i, stop - 1, j, j, 0,
                to_attributes, to_faces,
            )  # fmt: skip
        i = stop
