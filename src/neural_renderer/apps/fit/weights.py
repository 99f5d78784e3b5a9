"""Weights of the losses of a fit. This module does not import torch, so that `--help` starts fast."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real

from ..common.old_names import old_keywords


@old_keywords(edge_length="", smoothness="")
@dataclass(frozen=True)
class FitWeights:
    """Weights of the losses of a shape fit, ≥ 0; 0 disables a loss. The unit of length is half the longest side.

    Regularisers depend on the resolution of a mesh. Their weights are for 10,000 vertices and are converted for other
    meshes.

    Attributes:
        silhouette: Weight of 1 - IoU of silhouettes.
        photometric: Weight of the mean squared difference of colours, once vertices have colours.
        laplacian: Weight of the Laplacian loss.
        normal_consistency: Weight of 1 - cosine of the angle between adjacent faces.

    Raises:
        TypeError, ValueError: A weight is not a finite number ≥ 0.

    Example:
        >>> from neural_renderer.apps.fit import FitWeights
        >>> FitWeights(laplacian=50.0).laplacian
        50.0
    """

    silhouette: float = 1.0
    photometric: float = 4.0
    laplacian: float = 100.0
    normal_consistency: float = 0.2

    def __post_init__(self) -> None:
        _check_weights(vars(self))


@dataclass(frozen=True)
class DetailWeights:
    """Weights of the losses of a detail fit, ≥ 0; 0 disables a loss. All are mean absolute differences over pixels.

    Attributes:
        silhouette: Weight of silhouettes.
        normals: Weight of normals, summed over three channels.
        depth: Weight of depth, with half the longest side of the object as unit.
        photometric: Weight of colours, summed over three channels, if they count.
        albedo: Weight of the differences of albedo along edges, summed over three channels: their mean over the mesh.
        smooth: Share of the way to the mean of its neighbours that each vertex moves in a step, at first; at most 1.

    Raises:
        TypeError, ValueError: A weight is not a finite number ≥ 0, or ``smooth`` is above 1.

    Example:
        >>> from neural_renderer.apps.fit import DetailWeights
        >>> DetailWeights(normals=0.5).normals
        0.5
    """

    silhouette: float = 1.0
    normals: float = 1.0
    depth: float = 1.0
    photometric: float = 2.0
    albedo: float = 0.1
    smooth: float = 0.02

    def __post_init__(self) -> None:
        _check_weights(vars(self))
        if self.smooth > 1:
            raise ValueError(f"smooth: expected at most 1, got {self.smooth}")


def _check_weights(weights: dict[str, float]) -> None:
    """Raise TypeError or ValueError if a weight is not a finite number ≥ 0."""
    for name, value in weights.items():
        if not isinstance(value, Real):
            raise TypeError(f"{name}: expected a number, got {type(value).__name__}")
        if not 0 <= float(value) < math.inf:
            raise ValueError(f"{name}: expected a finite weight of at least 0, got {value}")
