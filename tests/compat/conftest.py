"""A stand-in for CUDA, so that old programs meet two kinds of memory on machines without a GPU, too."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
import torch

from neural_renderer.base import validate
from neural_renderer.raster.warp import launch, layout
from tests.cuda_emulation.tensors import Gpu


def on_cpu(kernel, tasks, arguments):
    """Run a launch on the CPU, where the numbers of the stand-in's tensors are."""
    launch._enter(kernel)(tasks, *arguments)
    return True


@pytest.fixture(autouse=True)
def stand_in_for_cuda(request, monkeypatch) -> Iterator[None]:
    """Where there is no GPU, tests on "cuda" use tensors that say they are on one and mix with no others."""
    device = getattr(request.node, "callspec", None) and request.node.callspec.params.get("device")
    if device != "cuda" or torch.cuda.is_available():
        yield
        return
    if launch.emulator is None:
        monkeypatch.setattr(launch, "emulator", on_cpu)
        monkeypatch.setattr(layout, "as_on_cuda", False)
    # Values of torch's own kinds of tensors alone are checked.
    monkeypatch.setattr(validate, "values_are_checked", lambda value: validate._check_values)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    torch.__future__.set_overwrite_module_params_on_conversion(
        True
    )  # a parameter's memory cannot become the stand-in's
    with Gpu():
        yield
    torch.__future__.set_overwrite_module_params_on_conversion(False)
