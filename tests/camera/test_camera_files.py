"""Camera files of other programs: poses, lenses, points, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps.common.views.undistortion import DISTORTIONS, undistort
from neural_renderer.camera.distortion import distorted
from neural_renderer.camera.files import find_camera_file, read_camera_file
from neural_renderer.camera.files.lens_models import MODELS, Lens
from tests.rounding import rounding

COLMAP = Path(__file__).parents[1] / "data" / "colmap"  # written by pycolmap
GOLDEN = json.loads((COLMAP / "projections.json").read_text())
SIZE = (48, 64)


def eyes(camera: nr.Camera) -> torch.Tensor:
    return camera.origin - torch.einsum("bij,bi->bj", camera.rotation, camera.translation)


@pytest.mark.parametrize("kind", ["binary/images.bin", "text/images.txt"])
def test_models_of_colmap(kind: str) -> None:
    found = read_camera_file(COLMAP / kind)
    assert [image.name for image in found.images] == [f"photo {i}.png" for i in range(6)]
    camera = found.cameras()
    torch.testing.assert_close(eyes(camera), torch.tensor(GOLDEN["eyes"]), **rounding(16, 4))
    assert camera.K is not None and camera.dist_coeffs is not None
    assert camera.K[2].tolist() == [[81, 0, 31], [0, 82, 24.5], [0, 0, 1]]
    torch.testing.assert_close(camera.dist_coeffs[0], torch.tensor([-0.05, 0, 0, 0, 0]))
    torch.testing.assert_close(camera.dist_coeffs[2], torch.tensor([-0.04, 0.01, 0.002, -0.001, 0]))
    assert found.points is not None and found.points.shape == (5, 3)
    half = found.cameras((24, 32))
    assert half.K is not None and half.K[4].tolist() == [[40, 0, 16], [0, 39.5, 12], [0, 0, 1]]


def test_binary_and_text_are_equal() -> None:
    binary, text = (read_camera_file(COLMAP / kind) for kind in ("binary/images.bin", "text/cameras.txt"))
    for mine, theirs in zip(binary.images, text.images, strict=True):
        torch.testing.assert_close(mine.rotation, theirs.rotation, rtol=0, atol=1e-15)
        assert mine.lens == theirs.lens and torch.equal(mine.translation, theirs.translation)
    torch.testing.assert_close(binary.points, text.points, rtol=1e-15, atol=0)


@pytest.mark.parametrize("model", MODELS)
def test_lens_models_are_those_of_colmap(model: str) -> None:
    """Pixels were computed by pycolmap and rounded to 1e-6."""
    points = torch.tensor(GOLDEN["points"], dtype=torch.float64)
    lens = Lens.of_model("", model, GOLDEN["models"][model]["parameters"], SIZE)
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    if lens.needs_undistortion:
        x, y = DISTORTIONS[model](x, y, lens.values)
    else:
        x, y = distorted(x, y, torch.tensor(lens.distortion(), dtype=torch.float64))
    K = torch.tensor(lens.intrinsics(SIZE), dtype=torch.float64)
    pixels = torch.stack((K[0, 0] * x + K[0, 2], K[1, 1] * y + K[1, 2]), 1)
    torch.testing.assert_close(
        pixels, torch.tensor(GOLDEN["models"][model]["pixels"], dtype=torch.float64), rtol=0, atol=1e-6
    )


def test_undistorted_image_shows_points_where_a_pinhole_does() -> None:
    lens = Lens.of_model("", "OPENCV_FISHEYE", [60.0, 60.0, 32.0, 24.0, 0.1, 0.0, 0.0, 0.0], SIZE)
    K = lens.intrinsics(SIZE)
    x, y = torch.tensor([0.3]), torch.tensor([-0.2])
    u, v = DISTORTIONS["OPENCV_FISHEYE"](x, y, lens.values)
    rows, columns = torch.meshgrid(torch.arange(48) + 0.5, torch.arange(64) + 0.5, indexing="ij")
    spot = torch.exp(-((columns - (60 * u + 32)) ** 2 + (rows - (60 * v + 24)) ** 2) / 8)
    straight = undistort(spot[None], "OPENCV_FISHEYE", lens.values, K)[0]
    place = (straight * torch.stack((columns, rows))).sum((1, 2)) / straight.sum()
    torch.testing.assert_close(place, torch.stack((60 * x + 32, 60 * y + 24))[:, 0], rtol=0, atol=0.15)


def by_hand(folder: Path, content: Any) -> Path:
    (folder / "cameras.json").write_text(json.dumps(content))
    return folder / "cameras.json"


VIEW = {"R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "t": [0, 0.5, 3]}
K = [[50, 0, 32], [0, 51, 24], [0, 0, 1]]


@pytest.mark.parametrize(
    "content",
    [
        {"K": K, "views": [{"file": "a.png", **VIEW}]},
        {"views": [{"file": "a.png", "K": K, **VIEW, "t": [[0], [0.5], [3]]}]},
        [{"file": "a.png", "K": K, **VIEW}],
        {"K": K, "a.png": VIEW},
    ],
)
def test_cameras_by_hand(tmp_path: Path, content: Any) -> None:
    found = read_camera_file(by_hand(tmp_path, content))
    pixels, depth = found.cameras(SIZE).project(torch.tensor([[0.6, 0.0, 0.0]]))
    torch.testing.assert_close(pixels[0, 0], torch.tensor([50 * 0.2 + 32, 51 * 0.5 / 3 + 24]), **rounding(16, 40))
    assert float(depth) == 3 and found.images[0].name == "a.png"


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ({"K": K, "views": [{"file": "a", **VIEW, "t": [1]}]}, "image 0: t: expected 3 finite numbers"),
        ({"K": K, "views": [{"file": "a", **VIEW, "R": [[2, 0, 0], [0, 1, 0], [0, 0, 1]]}]}, "R: expected a rotation"),
        ({"views": [{"file": "a", **VIEW}]}, 'expected the key "K"'),
        ({"K": [[0, 0, 0]] * 3, "views": [{"file": "a", **VIEW}]}, "K: expected focal lengths above 0"),
        ({"K": K[::-1], "views": [{"file": "a", **VIEW}]}, "K: expected"),
        ({"K": K, "views": []}, "expected at least one image"),
        ("text", 'expected the key "frames"'),
    ],
)
def test_cameras_by_hand_that_are_wrong(tmp_path: Path, content: Any, sentence: str) -> None:
    with pytest.raises(ValueError, match=rf"cameras\.json.*{sentence}"):
        read_camera_file(by_hand(tmp_path, content))


def test_middlebury(tmp_path: Path) -> None:
    numbers = [*K[0], *K[1], *K[2], 1, 0, 0, 0, 1, 0, 0, 0, 1, *VIEW["t"]]
    path = tmp_path / "thing_par.txt"
    path.write_text("1\na.png " + " ".join(map(str, numbers)) + "\n")
    assert find_camera_file(tmp_path) == path
    camera = read_camera_file(path).cameras(SIZE)
    assert camera.K is not None and camera.K[0].tolist() == K and camera.translation[0].tolist() == [0, 0.5, 3]
    path.write_text("1\na.png 1 2 3\n")
    with pytest.raises(ValueError, match=r"thing_par\.txt: line 2: expected a name and 21 finite numbers"):
        read_camera_file(path)


def test_fisheye_of_nerfstudio(tmp_path: Path) -> None:
    pose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]]
    lens = {"camera_model": "OPENCV_FISHEYE", "fl_x": 50, "fl_y": 51, "cx": 32, "cy": 24, "w": 64, "h": 48, "k1": 0.1}
    path = tmp_path / "transforms.json"
    path.write_text(json.dumps({**lens, "frames": [{"file_path": "a.png", "transform_matrix": pose}]}))
    found = read_camera_file(path).images[0].lens
    assert found.needs_undistortion and found.values["k1"] == 0.1 and found.size == (48, 64)


def test_models_that_no_lens_expresses(tmp_path: Path) -> None:
    for name in ("images.txt", "points3D.txt"):
        (tmp_path / name).write_text((COLMAP / "text" / name).read_text())
    (tmp_path / "cameras.txt").write_text("1 EQUIRECTANGULAR 64 48 1 2\n")
    with pytest.raises(ValueError, match=r"image 1: expected a camera of|got 'EQUIRECTANGULAR'"):
        read_camera_file(tmp_path / "images.txt")
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 64 48 1 2\n2 PINHOLE 64 48 1 2 3 4\n3 PINHOLE 64 48 1 2 3 4\n")
    with pytest.raises(ValueError, match="camera 1: expected 4 parameters of PINHOLE, got 2"):
        read_camera_file(tmp_path / "images.txt")


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin", "points3D.bin"])
def test_damaged_binary_files(tmp_path: Path, name: str) -> None:
    data = {path.name: path.read_bytes() for path in (COLMAP / "binary").iterdir()}
    for spoiled in (data[name][:-9], data[name][:3], b"\xff" * len(data[name])):
        for other, content in {**data, name: spoiled}.items():
            (tmp_path / other).write_bytes(content)
        with pytest.raises(ValueError, match=rf"{name}: "):
            read_camera_file(tmp_path / "images.bin")


def test_what_lies_in_a_folder(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="or a model of COLMAP"):
        find_camera_file(tmp_path)
    model = tmp_path / "sparse" / "0"
    model.mkdir(parents=True)
    for path in (COLMAP / "binary").iterdir():
        (model / path.name).write_bytes(path.read_bytes())
    assert find_camera_file(tmp_path) == model / "images.bin"
    assert tmp_path / "images" in read_camera_file(model / "images.bin").folders
