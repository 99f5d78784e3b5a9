"""Connected components of a graph."""

from __future__ import annotations

import torch
from torch import Tensor


def connected_components(groups: Tensor, count: int) -> Tensor:
    """Label ``count`` nodes of a graph by the lowest index in their connected component, [count] int64.

    Each of the groups [N, K] has K connected nodes, such as the ends of an edge or the corners of a face.
    """
    label = torch.arange(count, device=groups.device)
    while True:  # lower labels spread to the group, to the nodes that the group's labels name, and along chains
        lowest = label[groups].amin(1).repeat_interleave(groups.shape[1])
        spread = label.scatter_reduce(0, groups.flatten(), lowest, "amin")
        spread = spread.scatter_reduce(0, label[groups].flatten(), lowest, "amin")
        spread = spread[spread]
        if torch.equal(spread, label):
            return label
        label = spread
