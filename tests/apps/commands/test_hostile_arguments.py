"""What commands say about hostile arguments and surroundings."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps import command_line as cli
from neural_renderer.apps.common.features import load_features
from neural_renderer.apps.reconstruct.commands.predict import _naming
from neural_renderer.apps.reconstruct.evaluation.picture import load_shape_network
from neural_renderer.apps.reconstruct.networks.checkpoint import load_model


class Code:
    """Runs a program where it is unpickled."""

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.system, ("touch ran",)


@pytest.mark.parametrize("read", [load_shape_network, load_model, load_features])
def test_weights_with_code_are_refused_without_advice(
    read: Callable[[str], object], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, recwarn: pytest.WarningsRecorder
) -> None:
    monkeypatch.chdir(tmp_path)
    torch.save({"weights": Code()}, "a.pt")
    Path("b.pt").write_bytes(pickle.dumps(Code()))
    Path("c.pt").write_bytes(b"no weights")
    for name in ("a.pt", "b.pt", "c.pt"):
        with pytest.raises(ValueError, match=f"^{name}: ") as caught:
            read(name)
        assert "weights_only" not in str(caught.value) and "torch.load" not in str(caught.value)
    assert not Path("ran").exists()
    assert not [str(one.message) for one in recwarn if "pickle" in str(one.message)]  # torch asked to file an issue


def test_predict_names_both_pictures_of_a_mesh(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pictures = [tmp_path / "a" / "x.png", tmp_path / "b" / "x.png"]
    for picture in pictures:
        nr.save_image(picture, torch.rand(8, 8, 4))
    assert cli.main(["reconstruct", "predict", *map(str, pictures), "-o", str(tmp_path / "out")]) == 1
    told = capsys.readouterr().err
    assert str(pictures[0]) in told and str(pictures[1]) in told and "different names" in told


def test_warnings_of_predict_name_the_picture() -> None:
    with pytest.warns(UserWarning) as caught, _naming(Path("a.png")):
        warnings.warn("it is small", stacklevel=1)
        warnings.warn("a.png: it is dark", stacklevel=1)
    assert [str(one.message) for one in caught] == ["a.png: it is small", "a.png: it is dark"]


@pytest.mark.skipif(os.name != "posix", reason="handles have no numbers")
def test_closed_handles(tmp_path: Path) -> None:
    """As of a daemon: files would get the numbers of the standard outputs, and what is printed would go there."""
    nr.Mesh.icosphere(0).save(tmp_path / "a.obj")
    command = f"exec {sys.executable} -m neural_renderer render a.obj -o a.png --size 16 <&- >&- 2>&-"
    assert subprocess.run(["sh", "-c", command], cwd=tmp_path, timeout=300, check=False).returncode == 0
    assert nr.load_image(tmp_path / "a.png").shape[:2] == (16, 16)


@pytest.mark.skipif(os.name != "posix", reason="handles have no numbers")
def test_closed_handles_of_started_processes(tmp_path: Path) -> None:
    """Workers of dataset could not compile kernels without them."""
    program = "import os; from neural_renderer.apps import command_line as c; c._open_standard_handles(); "
    program += "open('told', 'w').write(str([os.get_inheritable(handle) for handle in range(3)]))"
    command = ["sh", "-c", f'exec {sys.executable} -c "{program}" <&- >&- 2>&-']
    assert subprocess.run(command, cwd=tmp_path, timeout=60, check=False).returncode == 0
    assert (tmp_path / "told").read_text() == "[True, True, True]"


def test_sizes_that_are_no_numbers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for arguments in (["render", "a.obj"], ["dataset", "a.obj"]):
        assert cli.main([*arguments, "-o", str(tmp_path / "x"), "--size", "big"]) == 2
        assert capsys.readouterr().err.startswith("--size: expected a side, or height and width such as --size 480 640")


def test_out_is_output(tmp_path: Path) -> None:
    nr.Mesh.icosphere(0).save(tmp_path / "a.obj")
    assert cli.main(["render", str(tmp_path / "a.obj"), "--out", str(tmp_path / "a.png"), "--size", "16"]) == 0
    assert (tmp_path / "a.png").is_file()


@pytest.mark.parametrize("focal", [0.0, 1e-30, 1e30])
def test_focal_lengths_that_draw_nothing(focal: float) -> None:
    intrinsics = torch.tensor([[100.0, 0, 8], [0, focal, 8], [0, 0, 1]])
    with pytest.raises(ValueError, match=r"K: expected focal lengths from 1e-09 to 1e\+09 pixels, got"):
        nr.Camera.projection(intrinsics, torch.eye(3), (0.0, 0.0, 3.0), orig_size=16)


def test_control_characters_do_not_reach_the_terminal(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Those of names of files; letters of all scripts do."""
    path = tmp_path / "\x1b]0;title\x07\u202eé.obj"
    assert cli.main(["render", str(path), "-o", str(tmp_path / "a.png")]) == 1
    message = capsys.readouterr().err
    assert "\\x1b]0;title\\x07\\u202eé.obj: expected" in message.replace("\n", "")
