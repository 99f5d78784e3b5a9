"""Gains: the change of the loss if a visible boundary moves outward by a pixel where a scan line crosses it."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import warp as wp

from .crossings import Crossing, Edge, face_at, pixel_at

wp.set_module_options({"enable_backward": False})

_GAIN = """
    #pragma clang fp contract(fast)
    const wp::int64 area = (wp::int64)image.shape[2] * image.shape[3];
    // Use the gradient of the pixel that contains the boundary. If a side is narrow, a visible centre may lie anywhere
    // in it; then interpolate between the two pixels.
    const float share = narrow ? offset : offset < 0.5f ? 0.0f : 1.0f;
    float sum = 0.0f;
    for (int c = 0; c < image.shape[1]; ++c) {
        const float* value = image.data + c * area;
        const float inside = weights[0] * value[before] + weights[1] * value[inner_color];
        const float outside = weights[2] * value[outer_color] + weights[3] * value[behind];
        const float* pull = grad.data + c * area;
        sum += (inside - outside) * ((1.0f - share) * pull[inner] + share * pull[outer]);
    }
    return sum;
"""


@wp.func_native(_GAIN)
def color_gain(
    image: wp.array4d(dtype=float),
    grad: wp.array4d(dtype=float),
    before: wp.int64,
    inner_color: wp.int64,
    outer_color: wp.int64,
    behind: wp.int64,
    weights: wp.vec4,
    inner: wp.int64,
    outer: wp.int64,
    offset: float,
    narrow: bool,
) -> float:
    """Sum (inside - outside) * gradient over the channels.

    Args:
        image: Colours.
        grad: Gradient to the image.
        before: Offset in memory of the pixel before ``inner_color``.
        inner_color: Offset of the pixel with the colour inside.
        outer_color: Offset of the pixel with the colour outside.
        behind: Offset of the pixel behind ``outer_color``.
        weights: Weights of these four colours: two are blended inside, two outside.
        inner: Offset of the pixel inside the boundary.
        outer: Offset of the pixel outside the boundary.
        offset: Distance from the centre of ``inner`` to the boundary, in pixels.
        narrow: Whether a face is narrower than a pixel here.
    """
    ...


@wp.func
def boundary_gain(
    edge: Edge,
    at: Crossing,
    inner_color: wp.int64,
    outer_color: wp.int64,
    weight: float,
    inside: wp.vec2,
    outside: wp.vec2,
    image: wp.array4d(dtype=float),
    grad: wp.array4d(dtype=float),
) -> float:
    """Compute the change of the loss if the boundary moves outward by a pixel at a crossing.

    Args:
        edge: Edge of the boundary.
        at: Crossing.
        inner_color: Offset in memory of the pixel with the colour inside.
        outer_color: Offset of the pixel with the colour outside.
        weight: Weight of the crossing; above 1 if a face is narrower than a pixel there.
        inside: Weights of the colour inside and of the next pixel's.
        outside: Weights of the colour outside and of the next pixel's.
        image: Colours.
        grad: Gradient to the image.
    """
    last = edge.length - 1
    before = wp.clamp(at.inner - edge.outward, 0, last)
    behind = wp.clamp(at.outer + edge.outward, 0, last)
    return color_gain(
        image,
        grad,
        pixel_at(image, edge.image, edge.axis, at.u, before),
        inner_color,
        outer_color,
        pixel_at(image, edge.image, edge.axis, at.u, behind),
        wp.vec4(inside[1], inside[0], outside[0], outside[1]),
        pixel_at(image, edge.image, edge.axis, at.u, at.inner),
        pixel_at(image, edge.image, edge.axis, at.u, at.outer),
        at.offset,
        weight > 1.0,
    )


@wp.func
def extrapolated(weight: float, offset: float, linear: bool) -> wp.vec2:
    """Weight the colours of the pixel beside a boundary and of the next one, to extrapolate to the boundary.

    Args:
        weight: Sum of the weights.
        offset: Distance from the centre of the first pixel to the boundary, in pixels.
        linear: Whether both pixels show one face, so that its colour continues along the slope between them. Otherwise
            only the first pixel's colour is used.

    Returns:
        Weights of the first pixel and of the next one.
    """
    if linear:
        return wp.vec2(weight * (1.0 + offset), -weight * offset)
    return wp.vec2(weight, 0.0)


@wp.func
def next_inside(edge: Edge, at: Crossing, face_index: wp.array3d(dtype=int)) -> int:
    """Read the face at the second pixel on the face's side of a crossing, as `face_at`."""
    return face_at(face_index, edge.image, edge.axis, at.u, at.inner - edge.outward, edge.length)


@wp.func
def next_outside(edge: Edge, at: Crossing, face_index: wp.array3d(dtype=int)) -> int:
    """Read the face at the second pixel on the other side of a crossing, as `face_at`."""
    return face_at(face_index, edge.image, edge.axis, at.u, at.outer + edge.outward, edge.length)
