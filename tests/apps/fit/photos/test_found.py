"""Masks that were found, and the backgrounds that other photographs show."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps.fit import Views, load_views
from neural_renderer.apps.fit.commands.cameras import _name
from neural_renderer.apps.fit.photos import place
from neural_renderer.apps.fit.photos.found import found_masks, record_found, with_backgrounds
from tests.apps.fit.photos.test_photos import scene


def test_masks_that_were_corrected_are_not_found_any_more(tmp_path: Path) -> None:
    assert found_masks(tmp_path) == set()
    for name in ("a.jpg", "b.jpg", "c.jpg"):
        nr.save_image(tmp_path / f"{name}.png", torch.eye(4))
    record_found(tmp_path, ["a.jpg", "b.jpg", "c.jpg", "missing.jpg"])
    nr.save_image(tmp_path / "b.jpg.png", torch.ones(4, 4))
    (tmp_path / "c.jpg.png").unlink()
    assert found_masks(tmp_path) == {"a.jpg"}
    for text in ("no JSON", "[]", '{"a.jpg": "many"}'):
        (tmp_path / "found.json").write_text(text)
        assert found_masks(tmp_path) == set()


def test_photographs_left_out_for_one_reason_are_named_together(capsys: pytest.CaptureFixture[str]) -> None:
    _name(
        {"a.jpg": "blurred", "b.jpg": "too few matches", "c.jpg": "blurred"} | {f"{n}.jpg": str(n) for n in range(11)}
    )
    lines = capsys.readouterr().err.splitlines()
    assert lines[:2] == ["a.jpg, c.jpg are left out: blurred", "b.jpg is left out: too few matches"]
    assert len(lines) == 13 and lines[-1] == "… and 1 more; report.json names them"


def views_of(folder: Path, size: int = 96) -> tuple[Views, torch.Tensor, list[torch.Tensor]]:
    cameras, masks = scene(folder, size)
    for number, mask in enumerate(masks):
        nr.save_image(folder / "masks" / f"{number}.png", mask)
    assert cameras.points is not None
    return load_views(cameras, size=size, masks=folder / "masks", scenes=True), cameras.points, masks


def test_other_views_show_the_background(tmp_path: Path) -> None:
    """Beside the object it is like the photograph, and behind it there is table; the exposure is the photograph's."""
    views, points, _ = views_of(tmp_path)
    assert views.scenes is not None
    darker = views.scenes.clone()
    darker[0] *= 0.8
    found = with_backgrounds(replace(views, scenes=darker), points, range(8)).backgrounds
    assert found is not None
    known = found.isfinite().all(1)
    beside = known & (views.masks < 0.01)
    for row in range(8):
        difference = (found[row] - darker[row]).abs().mean(0)
        assert float(difference[beside[row]].mean()) < 0.05  # the pattern has a standard deviation of 0.09
        assert int(beside[row].sum()) > 2000
    behind = known & (views.masks > 0.99)
    colors = found.movedim(1, 3)[behind]
    assert (
        len(colors) > 500 and float((colors[:, 1] >= colors[:, 0]).float().mean()) > 0.95
    )  # green, or black beside the table, not orange


def test_a_known_plane_is_not_searched(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the plane that a search finds, backgrounds are the same, and no search is needed."""
    views, points, _ = views_of(tmp_path)
    ground = place.find_place(views.camera, points, views.size).ground
    found = with_backgrounds(views, points, range(8)).backgrounds
    monkeypatch.setattr(place, "find_ground", lambda *_: pytest.fail("searched"))
    same = with_backgrounds(views, points, range(8), ground).backgrounds
    assert ground is not None and found is not None and same is not None
    assert torch.equal(found.nan_to_num(-1.0), same.nan_to_num(-1.0))


def test_masks_of_others_count_alone(tmp_path: Path) -> None:
    views, points, _ = views_of(tmp_path)
    found = with_backgrounds(views, points, [2, 3]).backgrounds
    assert found is not None
    assert found.isfinite().flatten(1).any(1).tolist() == [row in (2, 3) for row in range(8)]
    with pytest.raises(ValueError, match="views: expected scenes, got none"):
        with_backgrounds(replace(views, scenes=None), points, [0])


def test_a_background_that_changes_is_unknown(tmp_path: Path) -> None:
    """In one photograph a thing lies beside the object: nothing is known there."""
    views, points, _ = views_of(tmp_path)
    assert views.scenes is not None
    changed = views.scenes.clone()
    changed[4, :, 4:24, 70:90] = torch.tensor([0.9, 0.1, 0.9])[:, None, None]
    found = with_backgrounds(replace(views, scenes=changed), points, range(8)).backgrounds
    assert found is not None
    assert found[4, 0, 10:18, 76:84].isnan().all()
    assert found[3].isfinite().float().mean() > 0.5
