"""Downsampling of anti-aliased images: the mean of 2 x 2 pixels."""

# Warp reads the annotations of kernels at run time, so no `from __future__ import annotations` here.
import torch
import warp as wp
from torch import Tensor

from ..ops.coverage import coverage, silhouette
from ..warp.launch import array, copy, launch
from ..warp.layout import PIXELS_OF_TASK, pixel_tasks, worth_a_thread
from ..warp.memory import empty
from ..warp.registration import differentiable, operator

# These kernels are compiled with those of `coverage`, which every image needs: a module of their own would take longer.
_MODULE = wp.get_module(coverage.__module__)


@operator
def halve(image: Tensor) -> Tensor:
    """Average 2 x 2 blocks of an image; differentiable.

    Args:
        image: [B, C, H, W] float32; H and W even.

    Returns:
        [B, C, H / 2, W / 2] float32.
    """
    batch, channels, height, width = image.shape
    means = empty((batch, channels, height // 2, width // 2), image.device)
    _launch(_average, image, means)
    return means


@operator
def halve_backward(grad: Tensor) -> Tensor:
    """Send a quarter of each gradient to each pixel of its block: the transpose of `halve`."""
    batch, channels, height, width = grad.shape
    to_image = empty((batch, channels, 2 * height, 2 * width), grad.device)
    _launch(_spread, to_image, grad)
    return to_image


def averaged(image: Tensor | None, face_index: Tensor, halved: bool) -> Tensor:
    """Copy an image, or average its blocks of 2 x 2 pixels if ``halved``; None is the silhouette of ``face_index``."""
    if image is None:
        return silhouette(face_index, halved)
    return halve(image) if halved else copy(image)


def like_averaged(image: Tensor | None, face_index: Tensor, halved: bool) -> Tensor:
    """Make an empty tensor of the shape that `averaged` returns."""
    batch, height, width = face_index.shape
    scale, channels = 2 if halved else 1, 1 if image is None else image.shape[1]
    return face_index.new_empty((batch, channels, height // scale, width // scale), dtype=torch.float32)


def _launch(kernel: wp.Kernel, image: Tensor, means: Tensor) -> None:
    rows, width = means.shape[:3].numel(), means.shape[3]
    tasks, each = pixel_tasks(rows, width, image.device)
    arguments = [array(image.reshape(2 * rows, 2 * width)), array(means.reshape(rows, width)), each]
    launch(kernel, tasks, arguments, image.device, worth_a_thread(each * width))


@torch.library.register_fake("neural_renderer::halve")
def _(image):
    return image.new_empty((*image.shape[:2], image.shape[2] // 2, image.shape[3] // 2))


@torch.library.register_fake("neural_renderer::halve_backward")
def _(grad):
    return grad.new_empty((*grad.shape[:2], 2 * grad.shape[2], 2 * grad.shape[3]))


differentiable(halve, lambda ctx, grad: halve_backward(grad))
differentiable(halve_backward, lambda ctx, image: halve(image))


_BLOCKS = f"""
    const int all = means.shape[0], width = means.shape[1];
    {PIXELS_OF_TASK}
    for (int row = first; row < last; ++row) {{
        float* __restrict__ mean = means.data + (wp::int64)row * width;
        float* __restrict__ above = image.data + (wp::int64)row * 4 * width;
        float* __restrict__ below = above + 2 * width;
        for (int i = left; i < right; ++i) {{
            EACH
        }}
    }}
"""
# Quarters are added, because the sum of four values may overflow.
_AVERAGE = """
            mean[i] = (0.25f * above[2 * i] + 0.25f * below[2 * i])
                + (0.25f * above[2 * i + 1] + 0.25f * below[2 * i + 1]);
"""
_SPREAD = "above[2 * i] = above[2 * i + 1] = below[2 * i] = below[2 * i + 1] = 0.25f * mean[i];"


@wp.func_native(_BLOCKS.replace("EACH", _AVERAGE))
def average(image: wp.array2d(dtype=float), means: wp.array2d(dtype=float), task: int, each: int):
    """Average the blocks of a task."""
    ...


@wp.func_native(_BLOCKS.replace("EACH", _SPREAD))
def spread(image: wp.array2d(dtype=float), means: wp.array2d(dtype=float), task: int, each: int):
    """Fill the blocks of a task with a quarter of each value."""
    ...


@wp.kernel(module=_MODULE)
def _average(first: int, image: wp.array2d(dtype=float), means: wp.array2d(dtype=float), each: int):
    average(image, means, first + wp.tid(), each)


@wp.kernel(module=_MODULE)
def _spread(first: int, image: wp.array2d(dtype=float), means: wp.array2d(dtype=float), each: int):
    spread(image, means, first + wp.tid(), each)
