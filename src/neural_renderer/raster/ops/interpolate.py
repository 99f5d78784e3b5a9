"""Anything given at the corners of faces, at every pixel."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ..warp.geometry import in_front, pixel_box
from ..warp.launch import array, face_lanes, launch, zeros
from ..warp.registration import differentiable, differentiable_once, operator
from .visible_faces import next_shown, seen_faces

wp.set_module_options({"enable_backward": False})


@operator
def interpolate(attributes: Tensor, faces: Tensor, face_index: Tensor, weights: Tensor) -> Tensor:
    """The attributes of the corners mixed by the weights of each pixel; differentiable in attributes and weights.

    attributes: [B or 1, F, 3, C] float32, any number of channels.
    faces, face_index, weights: as `coverage` and `barycentrics` take and give them.

    Returns [B, H, W, C] float32, 0 where no face is seen.
    """
    batch, height, width = face_index.shape
    result = torch.empty((batch, height, width, attributes.shape[3]), dtype=torch.float32, device=faces.device)
    arguments = [array(attributes), array(face_index), array(weights, wp.vec3), array(result)]
    launch(_forward, batch * height, arguments, faces.device)
    return result


@torch.library.register_fake("neural_renderer::interpolate")
def _(attributes, faces, face_index, weights):  # type: ignore[no-untyped-def]
    return faces.new_empty((*face_index.shape, attributes.shape[3]))


@differentiable_once
def interpolate_backward(
    grad: Tensor, attributes: Tensor, faces: Tensor, face_index: Tensor, weights: Tensor
) -> tuple[Tensor, Tensor]:
    """The gradients of `interpolate` to attributes [B or 1, F, 3, C] and weights [B, H, W, 3]."""
    batch, height, width = face_index.shape
    count = faces.shape[1]
    to_attributes = zeros(attributes.shape, faces.device)
    to_weights = zeros(weights.shape, faces.device)
    lanes = face_lanes(faces, height * width)
    # Attributes that images share belong to one task, which takes the images in turn.
    images = 1 if attributes.shape[0] < batch else batch
    maps = [array(face_index), array(weights, wp.vec3), array(seen_faces(face_index, count)), array(grad)]
    results = [array(to_attributes), array(to_weights, wp.vec3)]
    arguments = [array(attributes), array(faces, wp.vec3), *maps, images, lanes, *results]
    launch(_backward, images * count * lanes, arguments, faces.device)
    return to_attributes, to_weights


@torch.library.register_fake("neural_renderer::interpolate_backward")
def _(grad, attributes, faces, face_index, weights):  # type: ignore[no-untyped-def]
    return attributes.new_empty(attributes.shape), weights.new_empty(weights.shape)


def _save(ctx, inputs, output):  # type: ignore[no-untyped-def]
    ctx.save_for_backward(*inputs)


def _to_inputs(ctx, grad):  # type: ignore[no-untyped-def]
    to_attributes, to_weights = interpolate_backward(grad, *ctx.saved_tensors)
    return to_attributes, None, None, to_weights


differentiable(interpolate, _to_inputs, _save)


_MIX_ROW = """
    const int channels = attributes.shape[3], width = face_index.shape[2];
    const wp::int64 images = attributes.shape[0], count = attributes.shape[1];
    const wp::int64 b = row / face_index.shape[1];
    const float* own = attributes.data + (b < images ? b : images - 1) * count * 3 * channels;
    for (int i = 0; i < width; ++i) {
        const wp::int64 pixel = row * width + i;
        const int f = face_index.data[pixel];
        float* to = result.data + pixel * channels;
        const float* from = own + (wp::int64)(f < 0 ? 0 : f) * 3 * channels;
        const wp::vec_t<3, float> w = weights.data[pixel];
        for (int c = 0; c < channels; ++c)
            to[c] = f < 0 ? 0.0f : w[0] * from[c] + w[1] * from[channels + c] + w[2] * from[2 * channels + c];
    }
"""


@wp.func_native(_MIX_ROW)
def mix_row(
    attributes: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    weights: wp.array3d(dtype=wp.vec3),
    result: wp.array4d(dtype=float),
    row: wp.int64,
):
    """Of all rows of all images, this one. In plain C++, which keeps the loop over channels tight."""
    ...


@wp.kernel
def _forward(
    first: int,
    attributes: wp.array4d(dtype=float),
    face_index: wp.array3d(dtype=int),
    weights: wp.array3d(dtype=wp.vec3),
    result: wp.array4d(dtype=float),
):
    mix_row(attributes, face_index, weights, result, wp.int64(first + wp.tid()))


_UNMIX = """
    const int channels = attributes.shape[3];
    const float *pull = grad.data + pixel * channels, *from = attributes.data + corner * channels;
    float* to = to_attributes.data + corner * channels;
    wp::vec_t<3, float> sums(0.0f);
    for (int k = 0; k < 3; ++k)
        for (int c = 0; c < channels; ++c) {
            sums[k] += from[k * channels + c] * pull[c];
            if (alone) to[k * channels + c] += w[k] * pull[c];
            else wp::atomic_add(&to[k * channels + c], w[k] * pull[c]);
        }
    return sums;
"""


@wp.func_native(_UNMIX)
def unmix(
    attributes: wp.array4d(dtype=float),
    corner: wp.int64,
    grad: wp.array4d(dtype=float),
    pixel: wp.int64,
    w: wp.vec3,
    alone: bool,
    to_attributes: wp.array4d(dtype=float),
) -> wp.vec3:
    """Add a pixel's gradient to its face's attributes, from ``corner`` on; returns that to the pixel's weights."""
    ...


@wp.kernel
def _backward(
    first: int,
    attributes: wp.array4d(dtype=float),
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    weights: wp.array3d(dtype=wp.vec3),
    seen: wp.array2d(dtype=int),
    grad: wp.array4d(dtype=float),
    images: int,
    lanes: int,
    to_attributes: wp.array4d(dtype=float),
    to_weights: wp.array3d(dtype=wp.vec3),
):
    """One face, of one image or of all, over the pixels that show it; with several lanes, each takes some rows."""
    task = first + wp.tid()
    lane = task % lanes
    f = (task // lanes) % faces.shape[1]
    own = (task // lanes) // faces.shape[1]
    height = face_index.shape[1]
    width = face_index.shape[2]
    corner = (wp.int64(own) * wp.int64(faces.shape[1]) + wp.int64(f)) * wp.int64(3)
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
        box = pixel_box(v0, v1, v2, in_front(v0, v1, v2, 1), height, width)
        for j in range(box[2] + lane, box[3] + 1, lanes):
            row = height - 1 - j
            line = wp.int64(b) * wp.int64(height) + wp.int64(row)
            i = next_shown(face_index, line, width, box[0], box[1] + 1, f)
            while i <= box[1]:
                pixel = line * wp.int64(width) + wp.int64(i)
                to_weights[b, row, i] = unmix(
                    attributes, corner, grad, pixel, weights[b, row, i], lanes == 1, to_attributes
                )
                i = next_shown(face_index, line, width, i + 1, box[1] + 1, f)
