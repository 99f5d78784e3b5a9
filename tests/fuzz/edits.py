"""Random changes of files, that follow from a generator of random numbers."""

from __future__ import annotations

import random
from collections.abc import Sequence
from typing import Any

from tests.mutations import KINDS, TOKENS, Edit, mutated


def edits(rng: random.Random) -> list[Edit]:
    """One to six changes."""
    return [
        Edit(rng.choice(KINDS), rng.random(), rng.random(), rng.randint(1, 60), rng.choice(TOKENS))
        for _ in range(rng.randint(1, 6))
    ]


def changed(data: bytes, containers: Sequence[Any], rng: random.Random) -> bytes:
    """Data with random changes, perhaps inside of a container; those of the whole where it is no container."""
    made, container = edits(rng), rng.choice(containers)

    def change(content: bytes) -> bytes:
        return mutated(content, made)

    try:
        return container(data, rng.random(), change)
    except Exception:  # a kept input may be no container any more
        return change(data)
