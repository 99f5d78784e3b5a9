"""The networks by their names."""

from __future__ import annotations

from ....features import FeatureNetwork
from .configs import Config
from .mesh_network import MeshNetwork
from .voxel_network import VoxelNetwork

Model = MeshNetwork | VoxelNetwork

NETWORKS: dict[str, type[MeshNetwork] | type[VoxelNetwork]] = {"mesh": MeshNetwork, "voxel": VoxelNetwork}


def make_network(kind: str, config: Config, features: FeatureNetwork | None = None) -> Model:
    """A network with fresh weights, and ``features`` for its encoder if that is "features".

    Raises ValueError for another name than "mesh" and "voxel", and for features that do not serve.
    """
    if kind not in NETWORKS:
        raise ValueError(f"model: expected one of {', '.join(NETWORKS)}, got {kind!r}")
    return NETWORKS[kind](config, features)
