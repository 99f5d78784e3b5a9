"""Which tests `--device` selects."""

from __future__ import annotations

import pytest
import torch

from tests.conftest import device_of, pytest_collection_modifyitems, pytest_configure


class Asked:
    """The part of a configuration of pytest that knows the option."""

    def __init__(self, device: str | None) -> None:
        self.hook, self.left_out = self, []
        self.getoption = {"--device": device}.get

    def pytest_deselected(self, items):
        self.left_out += items


def test_a_test_that_takes_a_device(request, device):
    assert device_of(request.node) == device


@pytest.mark.parametrize("asked", [None, "cpu", "cuda"])
def test_others_are_for_the_cpu_but_for_those_of_two_devices(request, asked):
    items = [request.node]
    config = Asked(asked)
    pytest_collection_modifyitems(config, items)
    assert items == [] if asked == "cuda" else items == [request.node]
    assert config.left_out == ([request.node] if asked == "cuda" else [])
    request.node.add_marker("two_devices")
    assert device_of(request.node) == "cuda"


def test_cuda_needs_a_gpu(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(pytest.UsageError, match="--device cuda: expected an NVIDIA GPU"):
        pytest_configure(Asked("cuda"))
