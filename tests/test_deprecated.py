"""Old names work for one version, with a warning."""

from __future__ import annotations

import pytest
import torch

import neural_renderer as nr
from neural_renderer.deprecated import old_argument
from neural_renderer.tasks import editing, fit


@pytest.mark.parametrize(
    ("module", "old", "new"),
    [(fit, "Weights", "FitWeights"), (fit, "frame", "object_bounds"), (editing, "Views", "RandomViews")],
)
def test_old_names_warn(module, old: str, new: str) -> None:
    with pytest.warns(DeprecationWarning, match=f"{old} is now {new}"):
        assert getattr(module, old) is getattr(module, new)


def test_other_names_are_unknown() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'Nothing'"):
        _ = fit.Nothing


def test_old_arguments_warn(tmp_path) -> None:
    nr.Mesh.icosphere(1).save(tmp_path / "ball.obj")
    mesh = nr.UVMesh.load(tmp_path / "ball.obj")
    fragments = nr.fragments(mesh, nr.Camera.look_at((0.0, 0.0, -3.0)), 8)
    with pytest.warns(DeprecationWarning, match="UVMesh.shade: seen is now fragments"):
        colors = mesh.shade(seen=fragments)  # type: ignore[call-arg]
    assert torch.equal(colors, mesh.shade(fragments)) and torch.equal(colors, mesh.shade(fragments=fragments))


def test_an_argument_is_given_once() -> None:
    @old_argument("old", "new")
    def function(new: int) -> int:
        return new

    with pytest.warns(DeprecationWarning), pytest.raises(TypeError, match="multiple values"):
        function(1, old=2)  # type: ignore[call-arg]
