"""Numbers that a GPU sends to the host: with a stand-in for what needs CUDA, as tensors on the CPU are sent."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest
import torch

from neural_renderer.base import arrivals


@pytest.mark.parametrize("numbers", [torch.tensor(3.5), torch.arange(5), torch.tensor([True, False])])
def test_the_copy_has_all_numbers_and_waits_for_its_event(
    monkeypatch: pytest.MonkeyPatch, numbers: torch.Tensor
) -> None:
    empty, there = torch.empty, [False]

    def unpinned(*shape: Any, pin_memory: bool, **options: Any) -> torch.Tensor:
        return empty(*shape, **options)

    event = SimpleNamespace(record=lambda stream: None, query=lambda: there[0])
    monkeypatch.setattr(torch, "empty", unpinned)
    monkeypatch.setattr(torch.cuda, "Event", lambda: event)
    monkeypatch.setattr(torch.cuda, "current_stream", lambda device: None)
    copy, has_arrived = arrivals.send(numbers)
    assert copy.dtype == numbers.dtype and torch.equal(copy, numbers)
    assert not has_arrived()
    there[0] = True
    assert has_arrived()
