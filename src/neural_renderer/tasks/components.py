"""Connected components of a graph."""

from __future__ import annotations

import torch
from torch import Tensor


def connected_components(groups: Tensor, count: int) -> Tensor:
    """Label the nodes of a graph by connected component.

    Args:
        groups: [N, K] int64: K nodes that are connected with each other, such as the ends of an edge or the corners of
            a face.
        count: Number of nodes.

    Returns:
        [count] int64, the lowest node index in the component of each node.
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
