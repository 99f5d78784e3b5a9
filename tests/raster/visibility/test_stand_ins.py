"""Steps from hidden faces to visible ones, against a search from each face."""

from __future__ import annotations

import pytest
import torch

from neural_renderer.raster.visibility.outlines import LONGEST
from neural_renderer.raster.visibility.stand_ins import steps_to_visible


def expected(visible: list[int], adjacent: list[list[int]]) -> list[int]:
    """Reach one step further at a time."""
    result = []
    for f in range(len(adjacent)):
        reached, steps = {f}, 0
        while steps <= LONGEST and not any(visible[g] for g in reached):
            reached, steps = {h for g in reached for h in adjacent[g] if h >= 0}, steps + 1
        result.append(min(steps, LONGEST + 1))
    return result


@pytest.mark.parametrize("share", [0.0, 0.02, 0.3])
def test_steps_of_random_surfaces(device, share):
    """Adjacent faces need not name each other, as where three faces share an edge."""
    random = torch.Generator().manual_seed(0)
    visible = (torch.rand(2, 101, generator=random) < share).int()
    adjacent = torch.randint(0, 100, (2, 100, 3), generator=random, dtype=torch.int32)
    adjacent[torch.rand(2, 100, 3, generator=random) < 0.6] = -1
    found = steps_to_visible(visible.to(device), adjacent.to(device)).cpu()
    assert found.tolist() == [expected(*one) for one in zip(visible.tolist(), adjacent.tolist(), strict=True)]
    assert share == 0 or len(found.unique()) > 4


def test_a_strip_of_faces(device):
    count = LONGEST + 3
    adjacent = torch.full((1, count, 3), -1, dtype=torch.int32)
    adjacent[0, 1:, 0], adjacent[0, :-1, 2] = torch.arange(count - 1).int(), torch.arange(1, count).int()
    visible = torch.zeros(1, count + 1, dtype=torch.int32)
    visible[0, [0, count]] = 1  # the last entry stands for pixels without a face
    found = steps_to_visible(visible.to(device), adjacent.to(device))
    assert found.tolist() == [[*range(LONGEST + 1), LONGEST + 1, LONGEST + 1]]
