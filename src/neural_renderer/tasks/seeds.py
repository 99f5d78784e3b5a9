"""Random numbers of tasks that can be interrupted and continued."""

from __future__ import annotations

import torch


def generator(seed: int, step: int) -> torch.Generator:
    """The random numbers of one step: they depend on nothing that came before, so that a run can be continued."""
    return torch.Generator().manual_seed((1_000_003 * seed + step) % 2**63)
