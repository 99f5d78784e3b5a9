"""Pretraining on generated shapes: it learns, resumes exactly, and its weights are those that `predict` takes."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from neural_renderer.apps import command_line as cli
from neural_renderer.apps.reconstruct.evaluation.picture import load_shape_network
from neural_renderer.apps.reconstruct.networks.shape_network import ShapeNetwork, pose_targets
from neural_renderer.apps.reconstruct.shapes.shapes import Shapes
from neural_renderer.apps.reconstruct.training import pretrain as training
from neural_renderer.apps.reconstruct.training.pretrain import pretrain


def test_a_resumed_training_ends_with_the_same_weights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(training, "make_batch", lambda shapes, step: make_batch(shapes, step, 4))
    whole = pretrain(Shapes(), tmp_path / "whole", steps=2)

    def stop(text: str) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):  # after the checkpoint of step 1
        pretrain(Shapes(), tmp_path / "parts", steps=2, every=1, tell=told(2, stop))
    resumed = pretrain(Shapes(), tmp_path / "parts", steps=2, resume=True)
    for name, value in whole.state_dict().items():
        assert torch.equal(value, resumed.state_dict()[name]), name
    loaded = load_shape_network(tmp_path / "parts" / "weights.pt")
    assert torch.equal(loaded.category.weight, resumed.category.weight.half().float())


make_batch = training.make_batch


def told(number: int, act):  # type: ignore[no-untyped-def]
    """Make a function that acts at its call of this number."""
    calls = []
    return lambda text: act(text) if len(calls.append(text) or calls) == number else None


def test_azimuths_are_shared_between_two_neighbours() -> None:
    pose = torch.tensor([[torch.pi / 48, 0.5, 2.0, 0.1, 0.2, 0.5], [0.0, 0.5, 2.0, 0.1, 0.2, 0.5]])
    target, numbers = pose_targets(pose)
    assert torch.allclose(target[0, [0, 1, 23]], torch.tensor([0.75, 0.25, 0.0]), atol=1e-6)
    assert torch.allclose(target.sum(1), torch.ones(2)) and torch.equal(target[1, :2], torch.tensor([1.0, 0.0]))
    assert torch.allclose(numbers[0], torch.tensor([0.5, 0.5, 0.1, 0.2, 0.5]))


def test_voxels_of_a_sample_are_those_of_the_grid() -> None:
    torch.manual_seed(0)
    network, images = ShapeNetwork(), torch.rand(2, 4, 64, 64)
    pose = torch.tensor([[0.5, 0.4, 2.7, 0.0, 0.0, 0.5]]).expand(2, 6)
    levels, chosen = network.encode(images), torch.tensor([5, 70, 30_000])
    whole = network.voxel_logits(levels, images, pose)
    part = network.voxel_logits(levels, images, pose, chosen)
    assert torch.allclose(part, whole[:, chosen], atol=1e-5)  # sums of at most 24 float32 products of order 1


def test_wrong_arguments(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["reconstruct", "pretrain", str(tmp_path), "--steps", "0"]) == 1
    assert "--steps: expected at least 1" in capsys.readouterr().err
    (tmp_path / "a.pt").write_bytes(b"text")
    with pytest.raises(ValueError, match="expected weights of a shape network"):
        torch.save({"weights": {}}, tmp_path / "b.pt")
        load_shape_network(tmp_path / "b.pt")
