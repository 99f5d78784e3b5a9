"""The sheets beside Mitsuba 3 and Filament, with stand-ins that return black pictures: what we ask can be asked."""

from __future__ import annotations

import sys
import types

import numpy as np
import pytest
import torch

import neural_renderer as nr
from benchmarks import gltf_sheet, layers_sheet, shading_sheet


class Transform:
    """Transforms of Mitsuba, which read nothing."""

    def look_at(self, origin: list[float], target: list[float], up: list[float]) -> Transform:
        return self

    def rotate(self, axis: list[float], angle: float) -> Transform:
        return self


def render(scene: dict, spp: int) -> np.ndarray:
    film = scene["sensor"]["film"]
    assert scene["type"] == "scene" and spp > 0
    return np.zeros((film["height"], film["width"], 3), np.float32)


@pytest.fixture
def mitsuba(monkeypatch: pytest.MonkeyPatch) -> None:
    names = {"set_variant": str, "ScalarTransform4f": Transform, "Bitmap": np.asarray, "load_dict": dict}
    monkeypatch.setitem(sys.modules, "mitsuba", types.SimpleNamespace(render=render, **names))  # type: ignore[arg-type]


def test_the_sheet_of_layers_is_drawn(mitsuba, tmp_path, monkeypatch, capsys) -> None:
    path = tmp_path / "layers.png"
    monkeypatch.setattr(sys, "argv", ["layers_sheet", "-o", str(path), "--size", "16", "--samples", "1"])
    layers_sheet.main()
    assert nr.load_image(path).shape[2] == 3
    assert "no reference" not in capsys.readouterr().out


@pytest.mark.slow
def test_every_row_of_the_sheet_of_shading_has_its_reference(mitsuba) -> None:
    rows = list(shading_sheet.pictures())
    found = [shading_sheet.reference(row, 8, 1) for row in rows]
    assert [row.name for row, picture in zip(rows, found, strict=True) if picture is None] == ["Phong"]
    assert all(picture is None or torch.equal(picture, torch.zeros(3, 8, 8)) for picture in found)


class Filament:
    """A stand-in for all classes of filly: every method returns one, and a picture is black."""

    def __init__(self, **size: int) -> None:
        self.size = size

    def __getattr__(self, name: str):
        return lambda *_, **given: Filament(**given)

    def __enter__(self) -> Filament:
        return self

    def __exit__(self, *error: object) -> None: ...

    def read(self) -> np.ndarray:
        return np.zeros((self.size["height"], self.size["width"], 4), np.uint8)


def test_the_sheet_of_gltf_files_is_drawn(tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.setitem(sys.modules, "filly", types.SimpleNamespace(Renderer=Filament))  # type: ignore[arg-type]
    vertices, faces = nr.icosphere(1)
    glass = (nr.Material("glass", opacity=0.5, alpha_mode="BLEND"),)
    nr.UVMesh(vertices, faces, vertices[:, :2], torch.ones(1, 1, 3), materials=glass).save(tmp_path / "glass.glb")
    path = tmp_path / "gltf.png"
    monkeypatch.setattr(sys, "argv", ["gltf_sheet", str(tmp_path / "glass.glb"), "-o", str(path), "--size", "48"])
    gltf_sheet.main()
    assert nr.load_image(path).shape[2] == 3
    said = capsys.readouterr().out
    assert "glass, environment" in said and "no reference" not in said
