"""Names and numbers that the command line shows in its help; they stand apart from what they set, which needs torch."""

from __future__ import annotations

import math
from dataclasses import dataclass
from numbers import Real
from typing import Literal

STYLE_LAYERS = ("conv1_2", "conv2_2", "conv3_3", "conv4_3")
"""Layers of VGG whose statistics are a style: the paper's, whose conv2_3 does not exist: the published code takes
conv2_2."""

DREAM_LAYER = "inception_4c"
"""Layer of GoogLeNet that a dream excites: the paper's."""

ConfigName = Literal["paper", "small", "best"]
"""Recipes of reconstruction, see `reconstruction.networks.configs`."""

ModelName = Literal["mesh", "voxel"]
"""Networks of reconstruction, see `reconstruction.networks.make_network`."""


@dataclass(frozen=True)
class FitWeights:
    """How much each loss of `losses` counts; 0: not at all. The unit of length is half the object's longest side.

    Bends and lengths shrink as a mesh gets finer. The weights on them are those of a mesh of 10,000 vertices, and are
    converted for others.
    """

    silhouette: float = 1.0
    """1 - intersection over union of the silhouettes."""
    photometric: float = 4.0
    """Mean squared difference of the colours, once vertices have colours."""
    laplacian: float = 100.0
    """Squared distance of a vertex to the mean of its neighbours."""
    edge_length: float = 0.0
    """Mean squared length of edges."""
    normal_consistency: float = 0.2
    """1 - cosine of the angle between neighbouring faces."""
    smoothness: float = 0.0
    """The paper's smoothness loss, a sum over edges."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not isinstance(value, Real):
                raise TypeError(f"{name}: expected a number, got {type(value).__name__}")
            if not 0 <= float(value) < math.inf:
                raise ValueError(f"{name}: expected a weight of at least 0 and finite, got {value}")
