"""The usual mistakes in sets of posed images, undone: turned images, exchanged conventions, scaled intrinsics."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from torch import Tensor

from ..fit_views import Views

_SCALES = (0.125, 0.25, 0.5, 2.0, 4.0, 8.0)


def remedies(views: Views) -> Iterator[tuple[str, Views]]:
    """Undo one usual mistake after the other.

    Args:
        views: Views that may have one of the mistakes.

    Yields:
        What was done, as the subject of a sentence, and the changed views.
    """
    yield from _of_images(views)
    if views.camera.K is not None:
        yield from _of_axes(views)
        yield from _of_intrinsics(views, views.camera.K)


def _of_images(views: Views) -> Iterator[tuple[str, Views]]:
    """Turn and mirror the images."""
    camera, masks = views.camera, views.masks
    yield "turning the images by 180°", Views(camera, masks.rot90(2, (1, 2)))
    yield "mirroring the images left to right", Views(camera, masks.flip(2))
    yield "mirroring the images top to bottom", Views(camera, masks.flip(1))
    for quarters, way in ((1, "counter-clockwise"), (3, "clockwise")):
        text, turned = f"turning the images by 90° {way}", masks.rot90(quarters, (1, 2))
        yield text, Views(camera, turned)
        if camera.orig_size is not None and camera.orig_size[0] != camera.orig_size[1]:
            # A file without sizes takes those of the images, which are exchanged, too.
            yield text, Views(replace(camera, orig_size=camera.orig_size[::-1]), turned)


def _of_axes(views: Views) -> Iterator[tuple[str, Views]]:
    """Exchange directions and axes of the matrices."""
    R, t = views.camera.rotation, views.camera.translation
    signs = R.new_tensor([1.0, -1.0, -1.0])
    axes = "OpenCV's camera axes (y down, z forward) and OpenGL's (y up, z backward)"
    direction = "camera-to-world and world-to-camera matrices"
    back, place = R.transpose(1, 2), views.eyes()[0]  # the inverse; its translation is the position of the camera
    yield f"exchanging {axes}", _posed(views, R * signs[:, None], t * signs)
    yield f"exchanging {direction}", _posed(views, back, place)
    text = f"exchanging {direction}, and {axes},"
    yield text, _posed(views, back * signs, place)
    yield text, _posed(views, back * signs[:, None], place * signs)
    yield text, _posed(views, back * signs[:, None] * signs, place * signs)


def _of_intrinsics(views: Views, K: Tensor) -> Iterator[tuple[str, Views]]:
    """Exchange width and height in the intrinsics, and scale them."""
    size = views.camera.orig_size or (1.0, 1.0)
    exchange = "exchanging width and height"
    aspect = size[1] / size[0]
    if aspect != 1:
        for factor in (aspect, 1 / aspect):
            yield f"{exchange} in the intrinsics", _with_K(views, _scaled(K, factor, 1 / factor))
        yield f"{exchange} of the field of view", _with_K(views, _scaled(K, aspect, aspect, 1.0))
        yield f"{exchange} of the field of view", _with_K(views, _scaled(K, 1 / aspect, 1 / aspect, 1.0))
    swapped = K.clone()
    swapped[:, 0, 2], swapped[:, 1, 2] = K[:, 1, 2], K[:, 0, 2]
    yield f"{exchange} in the principal point", _with_K(views, swapped)
    centered = size[1] / 2 / float(K[:, 0, 2].mean().clamp(min=1e-3 * size[1]))
    for scale in (*_SCALES, centered):
        yield f"scaling the intrinsics by {scale:.3g}", _with_K(views, _scaled(K, scale, scale))
        yield f"scaling the principal point by {scale:.3g}", _with_K(views, _scaled(K, 1.0, 1.0, scale))


def _scaled(K: Tensor, across: float, down: float, center: float | None = None) -> Tensor:
    """Scale the rows of K [N, 3, 3]; ``center`` is the factor of the principal point, if it is another one."""
    centers = (across, down) if center is None else (center, center)
    factors = [[across, across, centers[0]], [down, down, centers[1]], [1.0, 1.0, 1.0]]
    return K * K.new_tensor(factors)


def _with_K(views: Views, K: Tensor) -> Views:
    return Views(replace(views.camera, K=K), views.masks, None, views.region)


def _posed(views: Views, R: Tensor, t: Tensor) -> Views:
    return Views(replace(views.camera, rotation=R.contiguous(), translation=t), views.masks)
