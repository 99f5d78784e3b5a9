"""The demo in small: every file is written, and the fit gets better."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from PIL import Image

import neural_renderer as nr
from neural_renderer.apps import command_line as cli
from neural_renderer.apps.common.pictures.photograph import photograph
from neural_renderer.apps.common.pictures.sheet import sheet
from neural_renderer.apps.demo.models import duck

EXTRAS = (
    "cv2",
    "lightning",
    "manifold3d",
    "OpenEXR",
    "pyarrow",
    "pycolmap",
    "ray",
    "safetensors",
    "tensorboard",
    "viser",
    "xatlas",
)


def test_a_plain_installation_writes_its_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in EXTRAS:
        monkeypatch.setitem(sys.modules, name, None)  # `import name` fails
    small = {"frames": 2, "size": 32, "steps": 8, "views": 3, "view-size": 24}
    options = [text for name, value in small.items() for text in (f"--{name}", str(value))]
    assert cli.main(["demo", "-o", str(tmp_path / "out"), *options]) == 0
    out = capsys.readouterr().out
    assert "Silhouette IoU over 3 views" in out
    assert "knot.png after " in out  # before all others
    for name in ("knot.png", "turntable.gif", "fit.png", "fit.gif", "fitted.obj", "picture.png"):
        assert (tmp_path / "out" / name).stat().st_size > 100
        assert name in out
    assert (tmp_path / "out" / "turntable.mp4").is_file()
    assert nr.load_obj(tmp_path / "out" / "fitted.obj", load_texture=True)[2].shape[0] == 1280
    with Image.open(tmp_path / "out" / "fit.png") as picture:
        assert picture.size == (5 * 24, 6 * 24)


def test_bad_number(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["demo", "--view-size", "3"]) == 1
    assert capsys.readouterr().err.strip() == "--view-size: expected at least 16, got 3"


def test_photograph() -> None:
    picture = photograph(duck(24, 2), 145, size=(48, 64))
    assert picture.shape == (3, 48, 64)
    assert picture.min() >= 0 and picture.max() <= 1
    red, _, blue = picture[:, 20, 30]  # on the head
    assert red > blue + 0.3
    assert picture[:, :, 0].min() > 0.7  # backdrop
    assert sheet([[picture] * 2] * 3, ["a", "b", "c"]).shape == (3 * 48, 2 * 64, 3)
