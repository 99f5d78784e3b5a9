"""An observer of a training: what it sees, and what it may change."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from neural_renderer.apps.common.observer import Knob
from neural_renderer.apps.reconstruct.evaluation.predict import predict_meshes
from neural_renderer.apps.reconstruct.networks.checkpoint import make_network
from neural_renderer.apps.reconstruct.training.callbacks import STOPPED
from tests.apps.reconstruct.synthetic import SMALL
from tests.apps.reconstruct.training.test_training import small_training

pytestmark = pytest.mark.filterwarnings("ignore")


class Watcher:
    """Stops after some steps, and changes the learning rate at the first."""

    def __init__(self, stop_at: int, rate: float | None = None) -> None:
        self.paused = False
        self.seen: list[tuple[str, int, dict[str, float], dict[str, Any]]] = []
        self._stop_at, self._rate = stop_at, rate

    @property
    def stopped(self) -> bool:
        return len(self.seen) >= self._stop_at

    def observe(
        self, phase: str, step: int, steps: int, numbers: Mapping[str, float], mesh: Callable[[], Any], /
    ) -> None:
        self.seen.append((phase, step, dict(numbers), mesh()))

    def offer(self, knobs: Sequence[Knob], /) -> None:
        self.offered = [knob.name for knob in knobs]

    def changes(self) -> dict[str, Any]:
        rate, self._rate = self._rate, None
        return {} if rate is None else {"rate": rate}


@pytest.mark.parametrize("kind", ["mesh", "voxel"])
def test_predictions_are_seen_and_stop_ends_it(tmp_path: Path, kind: str) -> None:
    watcher, interrupted = Watcher(4, rate=1e-6), []
    training = small_training(
        tmp_path, kind, replace(SMALL, steps=20), observer=watcher, interrupted=interrupted, every=20
    )
    assert training.steps_done == 4 and interrupted == [STOPPED] and (tmp_path / "last.ckpt").is_file()
    assert [step for _, step, _, _ in watcher.seen] == [1, 2, 3, 4] and watcher.offered == ["rate"]
    assert training.rate_factor == pytest.approx(1e-6 / SMALL.rate)
    for _, _, numbers, meshes in watcher.seen:
        assert set(numbers) >= {"loss", "iou"}
        for vertices, faces in meshes.values():
            assert vertices.shape[1] == faces.shape[1] == 3 and int(faces.max()) < len(vertices)
    assert kind == "voxel" or watcher.seen[0][3]


def test_looking_changes_nothing(tmp_path: Path) -> None:
    """A training that is watched learns the same weights."""
    plain = small_training(tmp_path / "a", config=replace(SMALL, steps=4))
    watched = small_training(tmp_path / "b", config=replace(SMALL, steps=4), observer=Watcher(10**6))
    for one, other in zip(plain.state_dict().values(), watched.state_dict().values(), strict=True):
        assert torch.equal(one, other)


def test_a_refinement_is_seen_and_stopped() -> None:
    torch.manual_seed(0)
    network, images = make_network("mesh", SMALL).eval(), torch.zeros(1, 4, 64, 64, dtype=torch.uint8)
    images[:, 3, 16:48, 16:48] = 255
    watcher = Watcher(3)
    [(vertices, _)] = predict_meshes(network, images, refine=9, observer=watcher)
    assert [(phase, step) for phase, step, _, _ in watcher.seen] == [("refinement", step) for step in (1, 2, 3)]
    assert torch.equal(watcher.seen[-1][3][0], vertices)
    [(unseen, _)] = predict_meshes(network, images, refine=3)
    assert torch.equal(unseen, vertices)
