"""Names of networks and configurations. This module does not import torch, so that `--help` starts fast."""

from typing import Literal

ConfigName = Literal["paper", "small", "best"]
"""Configurations, see `networks.configs`."""

ModelName = Literal["mesh", "voxel"]
"""Networks, see `networks.make_network`."""
