"""Metrics without gradients."""

from __future__ import annotations

import torch
from torch import Tensor

from . import validate


def silhouette_iou(predicted: Tensor, target: Tensor, threshold: float = 0.5) -> Tensor:
    """Compute the intersection over union (IoU) of binary silhouettes.

    Args:
        predicted: [B, H, W] bool, or floating and compared with ``threshold``.
        target: [B, H, W], likewise.
        threshold: A pixel of a floating silhouette is covered if its value is above this.

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
    a, b = (v if v.dtype == torch.bool else v > threshold for v in (predicted, target))
    union = (a | b).sum((1, 2))
    return torch.where(union > 0, (a & b).sum((1, 2)) / union.clamp(min=1), 1.0)
