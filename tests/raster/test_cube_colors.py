"""Large textures are read for NaN once, and again after each change."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

import neural_renderer as nr
from neural_renderer.base import validate


@pytest.fixture
def checks(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The names of the textures that are read."""
    found: list[str] = []
    finite = validate.finite

    def recorded(name: str, value: Tensor, always: bool = False) -> float:
        found.extend([name] if name == "textures" else [])
        return finite(name, value, always)

    monkeypatch.setattr(validate, "finite", recorded)
    return found


def _draw(textures: Tensor) -> None:
    vertices, faces = nr.icosphere(3)
    nr.render((vertices, faces, textures), nr.Camera.look_at((0.0, 0.0, -2.7)), 8, outputs="rgb")


def test_tensors_are_read_once(checks: list[str]) -> None:
    textures = torch.rand(1280, 3, 3, 3, 3)
    for _ in range(3):
        _draw(textures)
    assert len(checks) == 1
    textures[5, 0, 1, 2, 0] = torch.nan
    with pytest.raises(ValueError, match="textures: expected finite numbers, got 1"):
        _draw(textures)
    assert len(checks) == 2


def test_arrays_are_read_in_each_call(checks: list[str]) -> None:
    array = np.random.default_rng(0).random((1280, 3, 3, 3, 3), np.float32)
    textures = torch.from_numpy(array)
    for _ in range(3):
        _draw(textures)
    assert len(checks) == 3
    array[5, 0, 1, 2, 0] = np.nan
    with pytest.raises(ValueError, match="textures: expected finite numbers, got 1"):
        _draw(textures)
