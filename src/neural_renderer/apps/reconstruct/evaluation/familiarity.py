"""Estimate the probability that a picture shows a kind of object that the shipped network has learned.

A logistic regression of numbers that the network gives for a picture, and of its code of the picture, calibrated on
objects that it was not trained on, of its kinds and of others (Platt, "Probabilistic outputs for support vector
machines", 1999). Probabilities of categories get a temperature (Guo et al., "On calibration of modern neural networks",
ICML 2017). `benchmarks/familiarity.py` makes the numbers of the file.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import torch
from torch import Tensor

from ..networks.shape_network import ShapeNetwork, expected_iou, outline_iou

CALIBRATION = Path(__file__).parents[1] / "networks" / "familiarity.json"
"""The numbers of the shipped network."""

EVIDENCE = ("energy", "category", "azimuth", "outline", "certainty")
"""The first numbers of `evidence`, in this order; the code of the picture follows."""

LEAST_FAMILIAR = 0.5
"""Probability below which an object is taken for one of another kind."""


@dataclass(frozen=True)
class Calibration:
    """Numbers that turn outputs of a network into probabilities.

    Attributes:
        temperature: Divisor of the logarithms of the categories' probabilities.
        weights: Weight of each number of `evidence` in the logit of the probability that the object is familiar.
        bias: Constant of this logit.
    """

    temperature: float
    weights: tuple[float, ...]
    bias: float

    def familiar(self, evidence: Tensor) -> Tensor:
        """Convert evidence [B, 261] to probabilities [B] that the objects are of the network's kinds."""
        return (evidence @ evidence.new_tensor(self.weights) + self.bias).sigmoid()

    def categories(self, probabilities: Tensor) -> Tensor:
        """Calibrate probabilities [B, C] of categories, given that an object is of one of them."""
        return (probabilities.clamp(min=1e-12).log() / self.temperature).softmax(-1)


@cache
def shipped_calibration() -> Calibration:
    """Read the numbers of the shipped network."""
    found = json.loads(CALIBRATION.read_text(encoding="utf-8"))
    return Calibration(found["temperature"], tuple(found["weights"]), found["bias"])


@torch.no_grad()
def evidence(network: ShapeNetwork, images: Tensor, occupancy: Tensor, pose: Tensor) -> Tensor:
    """Compute the features by which a familiar object is recognised: [B, 261], those of `EVIDENCE` and the code.

    The energy is the logarithm of the sum of the exponentials of the categories' logits; then the logarithms of the
    largest probabilities of categories and azimuths, the agreement of the outlines of picture and voxels, and the IoU
    that the probabilities of the voxels let expect. Code and logits are means over the pictures [B, 4, 64, 64] and
    their mirrors; voxels are [B, 32, 32, 32], poses [B, 6].
    """
    code = torch.stack([network.encode(seen)[-1] for seen in (images, images.flip(3))]).mean(0)
    logits = network.category(code)
    category, _, scores = network.recognize(images)
    numbers = (
        logits.logsumexp(1),
        category.amax(1).log(),
        scores[0],
        outline_iou(occupancy, images, pose),
        expected_iou(occupancy),
    )
    return torch.cat((torch.stack(numbers, 1), code), 1)
