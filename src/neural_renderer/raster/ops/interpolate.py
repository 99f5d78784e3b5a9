"""Anything given at the corners of faces, at every pixel."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ..warp.geometry import in_front, pixel_box
from ..warp.launch import array, face_lanes, launch, zeros
from ..warp.point import FACE
from ..warp.registration import differentiable, differentiable_once, operator
from .visible_faces import seen_faces

# As in `barycentrics`, whose weights these are, to the bit.
wp.set_module_options({"enable_backward": False, "fuse_fp": False})


@operator
def interpolate(attributes: Tensor, faces: Tensor, face_index: Tensor, perspective: bool) -> Tensor:
    """The attributes of the corners mixed by the weights of each pixel; differentiable in attributes and faces.

    attributes: [B or 1, F, 3, C] float32, any number of channels.
    faces, face_index, perspective: as `barycentrics` takes them, which says what the weights are. They are made anew,
        here and in backward, which is quicker than to keep images of them.

    Returns [B, H, W, C] float32, 0 where no face is seen.
    """
    batch, height, width = face_index.shape
    result = torch.empty((batch, height, width, attributes.shape[3]), dtype=torch.float32, device=faces.device)
    arguments = [array(attributes), array(faces, wp.vec3), array(face_index), int(perspective), array(result)]
    launch(_forward, batch * height, arguments, faces.device)
    return result


@torch.library.register_fake("neural_renderer::interpolate")
def _(attributes, faces, face_index, perspective):  # type: ignore[no-untyped-def]
    return faces.new_empty((*face_index.shape, attributes.shape[3]))


@differentiable_once
def interpolate_backward(
    grad: Tensor, attributes: Tensor, faces: Tensor, face_index: Tensor, perspective: bool, faces_too: bool
) -> tuple[Tensor, Tensor]:
    """The gradients of `interpolate` to attributes and faces [B, F, 3, 3] (empty if not ``faces_too``)."""
    batch, height, width = face_index.shape
    count = faces.shape[1]
    to_attributes = zeros(attributes.shape, faces.device)
    to_faces = zeros(faces.shape if faces_too else (0, 0, 3, 3), faces.device)
    lanes = face_lanes(faces, height * width)
    # Attributes that images share belong to one task, which takes the images in turn.
    images = 1 if attributes.shape[0] < batch else batch
    maps = [array(face_index), array(seen_faces(face_index, count)), array(grad)]
    options = [int(perspective), int(faces_too), images, lanes]
    results = [array(to_attributes), array(to_faces, wp.vec3)]
    arguments = [array(attributes), array(faces, wp.vec3), *maps, *options, *results]
    launch(_backward, images * count * lanes, arguments, faces.device)
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


def _for_channels(body: str) -> str:
    """The usual three channels are spelled out, so that compilers unroll the loops over them."""
    branch = (
        "if (attributes.shape[3] == 3) { const int channels = 3; BODY } else { const int channels = CHANNELS; BODY }"
    )
    return FACE + branch.replace("CHANNELS", "attributes.shape[3]").replace("BODY", body)


_MIX_ROW = _for_channels("""
    const int height = face_index.shape[1], width = face_index.shape[2];
    const int b = row / height, j = height - 1 - row % height;
    const wp::int64 images = attributes.shape[0], count = faces.shape[1];
    Face face;
    int last = -1;
    for (int i = 0; i < width; ++i) {
        const wp::int64 pixel = (wp::int64)row * width + i;
        const int f = face_index.data[pixel];
        float* to = result.data + pixel * channels;
        if (f < 0) {
            for (int c = 0; c < channels; ++c) to[c] = 0.0f;
            continue;
        }
        if (f != last) face.set(faces.data + (b * count + f) * 3, perspective, height, width);
        last = f;  // neighbours mostly show the same face
        wp::vec_t<3, float> w, on_screen;
        float whole;
        face.at(i, j, w, on_screen, whole);
        const float* from = attributes.data + ((b < images ? b : images - 1) * count + f) * 3 * channels;
        for (int c = 0; c < channels; ++c)
            to[c] = w[0] * from[c] + w[1] * from[channels + c] + w[2] * from[2 * channels + c];
    }
""")


@wp.func_native(_MIX_ROW)
def mix_row(
    attributes: wp.array4d(dtype=float),
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    perspective: int,
    result: wp.array4d(dtype=float),
    row: int,
):
    """Of all rows of all images, this one. In plain C++, which keeps the loop over channels tight."""
    ...


@wp.kernel
def _forward(
    first: int,
    attributes: wp.array4d(dtype=float),
    faces: wp.array3d(dtype=wp.vec3),
    face_index: wp.array3d(dtype=int),
    perspective: int,
    result: wp.array4d(dtype=float),
):
    mix_row(attributes, faces, face_index, perspective, result, first + wp.tid())


_UNMIX = _for_channels("""
    const int height = face_index.shape[1], width = face_index.shape[2];
    const wp::int64 count = faces.shape[1];
    const float* from = attributes.data + (own * count + f) * 3 * channels;
    float* to = to_attributes.data + (own * count + f) * 3 * channels;
    Face face;
    face.set(faces.data + (b * count + f) * 3, perspective, height, width);
    if (faces_too) face.gather();
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
""")


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
    lane: int,
    lanes: int,
    to_attributes: wp.array4d(dtype=float),
    to_faces: wp.array3d(dtype=wp.vec3),
):
    """A face's pixels in its box, every n-th row; ``own``: whose attributes."""
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
    """One face, of one image or of all, over the pixels that show it; with several lanes, each takes some rows."""
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
