"""Settings of a training, and names of networks and configurations. This module does not import torch."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

ConfigName = Literal["paper", "small", "best"]
"""Configurations, see `networks.configs`."""

ModelName = Literal["mesh", "voxel"]
"""Networks, see `networks.make_network`."""

VIEWS, SIZE = 24, 64
"""Views per object, and side of the images in pixels, of the published data set."""


@dataclass(frozen=True)
class RunSettings:
    """Settings of a training besides its network and data; `TrainOptions` explains them."""

    minutes: float = math.inf
    every: int = 250
    seed: int = 0
    workers: int = 0
    devices: int = 1
    nodes: int = 1
    device: Literal["auto", "cpu", "cuda"] = "auto"
    low_precision: bool = False
