"""Metrics without gradients."""

from __future__ import annotations

import torch
from torch import Tensor

from ..base import validate


def silhouette_iou(predicted: Tensor, target: Tensor, threshold: float | None = None) -> Tensor:
    """Compute the intersection over union (IoU) of silhouettes: Σ min(s, ŝ) / Σ max(s, ŝ) over pixels.

    Equal silhouettes have IoU 1, also anti-aliased ones. Rounding to eight bits, as in a PNG file, changes each partly
    covered pixel by at most 1/510. `losses.silhouette_iou_loss` is the loss.

    Args:
        predicted: [B, H, W] bool, or floating in [0, 1].
        target: [B, H, W], in the same range.
        threshold: Compare binary silhouettes: a pixel is covered if its value is above this. Choose a value that
            coverage does not take: anti-aliased pixels may have exactly 1/2, or 128/255 in a file.

    Returns:
        [B] float32 in [0, 1], without a gradient. Two empty silhouettes have IoU 1.

    Raises:
        TypeError, ValueError: An argument is not a tensor, or the shapes differ.

    Example:
        >>> square = torch.zeros(1, 8, 8)
        >>> square[:, 2:6, 2:6] = 1
        >>> silhouette_iou(square, square.roll(1, 2))  # 12 pixels of 20 are shared
        tensor([0.6000])
    """
    for name, value in (("predicted", predicted), ("target", target)):
        if not isinstance(value, Tensor):
            raise TypeError(f"{name}: expected a torch tensor, got {type(value).__name__}")
        validate.dense(name, value)
    if predicted.ndim != 3 or predicted.shape != target.shape:
        shapes = f"{validate.shape_of(predicted)} and {validate.shape_of(target)}"
        raise ValueError(f"predicted and target: expected the same shape [B, H, W], got {shapes}")
    validate.same_device(predicted=predicted, target=target)
    a, b = (v if v.dtype == torch.bool or threshold is None else v > threshold for v in (predicted, target))
    a, b = a.detach().float(), b.detach().float()
    union = torch.maximum(a, b).sum((1, 2))
    return torch.where(union == 0, 1.0, torch.minimum(a, b).sum((1, 2)) / union)  # in this order NaN stays NaN
