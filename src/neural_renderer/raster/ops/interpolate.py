"""Interpolation of corner attributes at every pixel."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ..warp.geometry import in_front, pixel_box
from ..warp.launch import array, face_lanes, face_tasks, launch, row_tasks, worth_a_thread, zeros
from ..warp.point import FACE, over_rows
from ..warp.registration import differentiable, differentiable_once, operator
from .visible_faces import seen_faces

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
    result = torch.empty((batch, height, width, attributes.shape[3]), dtype=torch.float32, device=faces.device)
    tasks, each = row_tasks(batch * height, faces.device)
    arguments = [array(attributes), array(faces, wp.vec3), array(face_index), int(perspective), each, array(result)]
    launch(_forward, tasks, arguments, faces.device, worth_a_thread(each * width))
    return result


@torch.library.register_fake("neural_renderer::interpolate")
def _(attributes, faces, face_index, perspective):  # type: ignore[no-untyped-def]
    return faces.new_empty((*face_index.shape, attributes.shape[3]))


@differentiable_once
def interpolate_backward(
    grad: Tensor, attributes: Tensor, faces: Tensor, face_index: Tensor, perspective: bool, faces_too: bool
) -> tuple[Tensor, Tensor]:
    """Compute the gradients of `interpolate` to attributes and to faces, [B, F, 3, 3]; empty if not ``faces_too``."""
    batch, height, width = face_index.shape
    count = faces.shape[1]
    to_attributes = zeros(attributes.shape, faces.device)
    to_faces = zeros(faces.shape if faces_too else (0, 0, 3, 3), faces.device)
    lanes = face_lanes(faces, height * width)
    # If images share attributes, one task sums the gradient to them, image by image.
    images = 1 if attributes.shape[0] < batch else batch
    maps = [array(face_index), array(seen_faces(face_index, count)), array(grad)]
    options = [int(perspective), int(faces_too), images, lanes]
    results = [array(to_attributes), array(to_faces, wp.vec3)]
    arguments = [array(attributes), array(faces, wp.vec3), *maps, *options, *results]
    launch(_backward, images * count * lanes, arguments, faces.device, face_tasks(faces, height * width))
    return to_attributes, to_faces


@torch.library.register_fake("neural_renderer::interpolate_backward")
def _(grad, attributes, faces, face_index, perspective, faces_too):  # type: ignore[no-untyped-def]
    return attributes.new_empty(attributes.shape), faces.new_empty(faces.shape if faces_too else (0, 0, 3, 3))


def _save(ctx, inputs, output):  # type: ignore[no-untyped-def]
    *tensors, ctx.perspective = inputs
    ctx.save_for_backward(*tensors)


def _to_inputs(ctx, grad):  # type: ignore[no-untyped-def]
    faces_too = ctx.needs_input_grad[1]
    to_attributes, to_faces = interpolate_backward(grad, *ctx.saved_tensors, ctx.perspective, faces_too)
    return to_attributes, to_faces if faces_too else None, None, None


differentiable(interpolate, _to_inputs, _save)


# Three channels, the usual number, have a loop of constant length, because compilers unroll it.
_MIX = """
            const wp::int64 images = attributes.shape[0];
            const float* from = attributes.data + ((b < images ? b : images - 1) * count + f) * 3 * channels;
            float* to = result.data + pixel * channels;
            const auto mixed = [&](int c, int stride) {
                to[c] = weights[0] * from[c] + weights[1] * from[stride + c] + weights[2] * from[2 * stride + c];
            };
            if (channels == 3) for (int c = 0; c < 3; ++c) mixed(c, 3);
            else for (int c = 0; c < channels; ++c) mixed(c, channels);
"""


@wp.func_native(
    over_rows(
        _MIX,
        "memset(result.data + pixel * channels, 0, (wp::int64)empty * channels * sizeof(float));",
        "const int channels = attributes.shape[3];",
    )
)
def mix_rows(
    attributes: wp.array4d(dtype=float),
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    perspective: int,
    result: wp.array4d(dtype=float),
    first: int,
    last: int,
):
    """Interpolate in the rows [first, last), counted over all images."""
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
    row = (first + wp.tid()) * each
    last = wp.min(row + each, face_index.shape[0] * face_index.shape[1])
    mix_rows(attributes, faces, face_index, perspective, result, row, last)


_UNMIX = (
    FACE
    + """
    const int channels = attributes.shape[3], height = face_index.shape[1], width = face_index.shape[2];
    const wp::int64 count = faces.shape[1];
    const float* from = attributes.data + (own * count + f) * 3 * channels;
    float* to = to_attributes.data + (own * count + f) * 3 * channels;
    Face face;
    face.set(faces.data + (b * count + f) * 3, perspective, height, width);
    if (faces_too) face.gather();
    EIGHT
    for (int j = bottom + lane; j <= top; j += lanes) {
        const wp::int64 row = ((wp::int64)b * height + height - 1 - j) * width;
        for (int i = left; i <= right; ++i) {
            if (face_index.data[row + i] != f) continue;
            wp::vec_t<3, float> w, on_screen, to_w(0.0f);
            float whole;
            const float z = face.at(i, j, w, on_screen, whole);
            const float* pull = grad.data + (row + i) * channels;
            for (int k = 0; k < 3; ++k)
                for (int c = 0; c < channels; ++c) {
                    to_w[k] += from[k * channels + c] * pull[c];
                    if (lanes == 1) to[k * channels + c] += w[k] * pull[c];
                    else wp::atomic_add(&to[k * channels + c], w[k] * pull[c]);
                }
            if (faces_too) face.pull(to_w, 0.0f, w, on_screen, whole, z);
        }
    }
    if (faces_too) face.give(to_faces.data + (b * count + f) * 3, lanes == 1);
"""
)
# The same for eight pixels at once, on the CPU; lanes are added at the end of the face.
_EIGHT = """
    #if !defined(__CUDA_ARCH__)
    typedef float floats __attribute__((ext_vector_type(8)));
    typedef int ints __attribute__((ext_vector_type(8)));
    const ints ahead = {0, 1, 2, 3, 4, 5, 6, 7};
    const auto sum = [](floats v) { return v[0] + v[1] + v[2] + v[3] + (v[4] + v[5] + v[6] + v[7]); };
    const floats none = 0.0f;
    const int most = 8;
    bool plain = face.front && face.known && width >= 8 && channels <= most;
    floats sums[3 * most], corner[9];
    for (int k = 0; k < 3 * channels && plain; ++k) sums[k] = none;
    for (int k = 0; k < 9; ++k) corner[k] = none;
    for (int j = bottom; j <= top && plain; ++j) {
        const wp::int64 row = ((wp::int64)b * height + height - 1 - j) * width;
        for (int i = left; i <= right && plain; i += 8) {
            const int at = i < width - 8 ? i : width - 8;
            ints shown;
            memcpy(&shown, face_index.data + row + at, sizeof(shown));
            const ints here = (shown == f) & (ahead >= i - at);
            if (__builtin_reduce_or(here) == 0) continue;
            const floats x = __builtin_convertvector(ahead + at, floats);
            floats w[3], shares[3], to_w[3] = {none, none, none};
            for (int k = 0; k < 3; ++k) {
                const float along = face.matrix[3 * k + 1] * (float)j;
                const floats share = x * face.matrix[3 * k] + along + face.matrix[3 * k + 2];
                w[k] = share < 0.0f ? none : share > 1.0f ? none + 1.0f : share;
            }
            const floats whole = w[0] + w[1] + w[2];
            // Fall back to single pixels, also for 0 / 0 beside the face: NaN times 0 is NaN.
            if (__builtin_reduce_or(whole == 0.0f)) {
                plain = false;
                break;
            }
            const floats part = 1.0f / whole;
            floats z = part;
            for (int k = 0; k < 3; ++k) shares[k] = perspective ? w[k] * face.inverse[k] : w[k] * part;
            if (perspective) {
                const floats near = 1.0f / (shares[0] + shares[1] + shares[2]);
                for (int k = 0; k < 3; ++k) shares[k] *= near;
                z = whole * near;
            }
            for (int c = 0; c < channels; ++c) {
                const float* g = grad.data + (row + at) * channels + c;
                floats pull = {g[0], g[channels], g[2 * channels], g[3 * channels], g[4 * channels], g[5 * channels],
                               g[6 * channels], g[7 * channels]};
                pull = here ? pull : none;
                for (int k = 0; k < 3; ++k) {
                    sums[3 * c + k] += shares[k] * pull;
                    to_w[k] += from[k * channels + c] * pull;
                }
            }
            if (!faces_too) continue;
            const floats same = to_w[0] * shares[0] + to_w[1] * shares[1] + to_w[2] * shares[2];
            floats right = none, up = none, g[3];
            for (int k = 0; k < 3; ++k) {
                g[k] = perspective ? z * (to_w[k] - same) * face.inverse[k] : to_w[k];
                right += g[k] * face.dx[k], up += g[k] * face.dy[k];
            }
            for (int k = 0; k < 3; ++k) {
                const floats share = here ? w[k] * part : none;
                corner[3 * k] -= right * share;
                corner[3 * k + 1] -= up * share;
                if (perspective) corner[3 * k + 2] -= share * g[k] * face.inverse[k];
            }
        }
    }
    if (plain) {
        for (int c = 0; c < channels; ++c)
            for (int k = 0; k < 3; ++k) to[k * channels + c] += sum(sums[3 * c + k]);
        for (int k = 0; k < 9; ++k) face.to[k] = sum(corner[k]);
        if (faces_too) face.give(to_faces.data + (b * count + f) * 3, true);
        return;
    }
    #endif
"""


@wp.func_native(_UNMIX.replace("EIGHT", _EIGHT))
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
    lane: int,
    lanes: int,
    to_attributes: wp.array4d(dtype=float),
    to_faces: wp.array3d(dtype=wp.vec3),
):
    """Sum the gradients of a face's pixels in its box, over every n-th row; its attributes belong to image ``own``."""
    ...


@wp.kernel
def _backward(
    first: int,
    attributes: wp.array4d(dtype=float),
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    seen: wp.array2d(dtype=int),
    grad: wp.array4d(dtype=float),
    perspective: int,
    faces_too: int,
    images: int,
    lanes: int,
    to_attributes: wp.array4d(dtype=float),
    to_faces: wp.array3d(dtype=wp.vec3),
):
    """Visit the pixels that show one face, in one image or in all; with several lanes, each takes every n-th row."""
    task = first + wp.tid()
    lane = task % lanes
    f = (task // lanes) % faces.shape[1]
    own = (task // lanes) // faces.shape[1]
    from_image = own
    to_image = own + 1
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
        if front >= 0:
            box = pixel_box(v0, v1, v2, front, face_index.shape[1], face_index.shape[2])
            unmix_face(
                attributes, own, faces, face_index, grad, perspective, faces_too, b, f, box[0], box[1], box[2], box[3],
                lane, lanes, to_attributes, to_faces,
            )  # fmt: skip
