"""Random calls of the interface of nvdiffrast; sanitizers watch them in `make test-native`."""

from __future__ import annotations

import random

from tests.fuzz import calls

COUNT = 60


def test_random_calls() -> None:
    rng = random.Random(1)
    for _ in range(COUNT):
        calls.run(calls.draw(rng))
