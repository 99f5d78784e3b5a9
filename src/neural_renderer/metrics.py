"""Measures of how well shapes agree."""

from __future__ import annotations

import torch
from torch import Tensor

from . import validate


def silhouette_iou(predicted: Tensor, target: Tensor, threshold: float = 0.5) -> Tensor:
    """Intersection over union of binary silhouettes, one number in [0, 1] for each image.

    Args:
        predicted: [B, H, W], floating (a pixel is covered above ``threshold``) or bool.
        target: likewise.

    Returns:
        [B] float32, without a gradient; two empty silhouettes agree (1).

    Raises:
        TypeError, ValueError: not tensors, or shapes that differ.
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
