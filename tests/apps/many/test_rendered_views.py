"""`RenderedViews`: what is drawn, in which process, in which epoch; and its memory."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from torch.utils.data import DataLoader

import neural_renderer as nr
from neural_renderer.data import RenderedViews


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    vertices, faces = nr.icosphere(1)
    for number in range(5):
        nr.save_mesh(tmp_path / f"ball_{number}.ply", vertices * torch.tensor([1.0, 1.0 + number, 1.0]), faces)
    return tmp_path


def drawn(views: RenderedViews, **options: Any) -> dict[int, torch.Tensor]:
    """The images of each model, by number."""
    found: dict[int, torch.Tensor] = {}
    for item in DataLoader(views, batch_size=None, **options):
        assert len(item["rgb"]) == len(item["camera"]) == len(item["model"])
        for number in item["model"].unique().tolist():
            assert number not in found
            found[number] = item["rgb"][item["model"] == number]
    return found


def test_images_are_those_of_their_cameras(folder: Path) -> None:
    views = RenderedViews(folder, (20, 24), 2, batch=3, outputs=("rgb", "alpha", "depth", "face_index"), light="none")
    items = list(views)
    assert [len(item["camera"]) for item in items] == [6, 4]
    assert items[0]["rgb"].shape == (6, 3, 20, 24) and items[0]["face_index"].dtype == torch.int32
    for item in items:
        for row, number in enumerate(item["model"].tolist()):
            mesh = nr.Mesh.load(folder / f"{views.models[number]}.ply").normalize()
            image = nr.render(mesh, item["camera"][row], (20, 24), outputs="alpha")
            torch.testing.assert_close(image.alpha[0], item["alpha"][row])


def test_views_do_not_depend_on_workers(folder: Path) -> None:
    views = RenderedViews(folder, 16, 2)
    here, there = drawn(views), drawn(views, num_workers=2)
    assert here.keys() == there.keys() == set(range(5))
    assert all(torch.equal(here[number], there[number]) for number in here)
    views.set_epoch(1)
    later = drawn(views)
    assert not any(torch.equal(here[number], later[number]) for number in here)


def test_processes_share_the_models_evenly(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    views = RenderedViews(folder, 8, 1)
    monkeypatch.setenv("WORLD_SIZE", "2")
    seen: set[int] = set()
    for epoch in range(12):
        views.set_epoch(epoch)
        shares = []
        for rank in "01":
            monkeypatch.setenv("RANK", rank)
            shares.append(set(drawn(views)))
        assert [len(share) for share in shares] == [2, 2] and not shares[0] & shares[1]
        seen |= shares[0] | shares[1]
    assert seen == set(range(5))


def test_memory_is_bounded_and_broken_models_are_left_out(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "broken.obj").write_text("v 1 2\nf 1 2 3\n")
    loads: list[Path] = []
    load = nr.UVMesh.load
    monkeypatch.setattr(nr.UVMesh, "load", lambda path, *rest: loads.append(path) or load(path, *rest))
    views = RenderedViews(folder, 8, 1)
    for _ in range(2):
        with pytest.warns(UserWarning, match="broken is left out"):
            assert len(list(views)) == 5
    assert len(loads) == 7  # a broken one is tried again
    assert 0 < views._size_of_meshes < 1e6
    small = RenderedViews(folder, 8, 1, memory=1)
    with pytest.warns(UserWarning, match="broken"):
        list(small)
    assert not small._meshes and small._size_of_meshes == 0


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"views": 0}, "views: expected"),
        ({"batch": 0}, "batch: expected"),
        ({"outputs": ("gold",)}, "outputs: expected some of rgba"),
        ({"light": "moon"}, "light: expected"),
        ({"size": 0}, "size: expected"),
    ],
)
def test_bad_arguments(folder: Path, options: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        RenderedViews(folder, **options)
