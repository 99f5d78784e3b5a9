"""Random numbers for tasks that can be interrupted and resumed."""

from __future__ import annotations

import torch


def generator(seed: int, step: int) -> torch.Generator:
    """Make a random generator that depends on seed and step only, so that a resumed run equals an uninterrupted one."""
    return torch.Generator().manual_seed((1_000_003 * seed + step) % 2**63)
