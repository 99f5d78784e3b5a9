"""Downsampling of anti-aliased images: the mean of 2 x 2 pixels."""

import torch
import torch.nn.functional as F
from torch import Tensor

from ..warp.registration import differentiable, operator


@operator
def halve(image: Tensor) -> Tensor:
    """Average 2 x 2 blocks of an image.

    torch's own pooling takes several times as long for images of one channel.

    Args:
        image: [B, C, H, W] float32; H and W even.

    Returns:
        [B, C, H / 2, W / 2] float32, contiguous.
    """
    # Multiply first, because the sum may overflow float32.
    rows = image[..., 0::2, :].mul(0.25).add_(image[..., 1::2, :], alpha=0.25)
    return (rows[..., 0::2] + rows[..., 1::2]).contiguous()


@operator
def halve_backward(grad: Tensor) -> Tensor:
    """Send a quarter of each gradient to each pixel of its block: the transpose of `halve`."""
    if not grad.numel():  # torch refuses to enlarge empty images
        return grad.new_zeros((*grad.shape[:2], 2 * grad.shape[2], 2 * grad.shape[3]))
    return F.interpolate(grad.contiguous() * 0.25, scale_factor=2, mode="nearest")


@torch.library.register_fake("neural_renderer::halve")
def _(image):
    return image.new_empty((*image.shape[:2], image.shape[2] // 2, image.shape[3] // 2))


@torch.library.register_fake("neural_renderer::halve_backward")
def _(grad):
    return grad.new_empty((*grad.shape[:2], 2 * grad.shape[2], 2 * grad.shape[3]))


differentiable(halve, lambda ctx, grad: halve_backward(grad))
