"""Camera files of IDR, NeuS, BOP and instant-ngp: their values, and what is refused in which words."""

from __future__ import annotations

import copy
import io
import json
import random
import re
import warnings
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import neural_renderer as nr
from neural_renderer.camera.files import find_camera_file, read_camera_file
from neural_renderer.camera.files.load import load_cameras

K = np.array([[500.0, 1.5, 320.0], [0.0, 480.0, 250.0], [0.0, 0.0, 1.0]])
SIZE = (480, 640)


def poses(count: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rotations and translations that put the unit ball before the camera."""
    rows = np.random.default_rng(0)
    turns = [np.linalg.qr(rows.standard_normal((3, 3)))[0] for _ in range(count)]
    return [(turn * np.sign(np.linalg.det(turn)), np.array([0.1, -0.2, 4.0 + n])) for n, turn in enumerate(turns)]


def projected(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    rows = np.concatenate((points, np.ones((len(points), 1))), 1) @ matrix[:3].T
    return rows[:, :2] / rows[:, 2:]


@pytest.mark.parametrize("name", ["cameras.npz", "cameras_sphere.npz"])
@pytest.mark.parametrize("factor", [1.0, -3.0, 1e-4])
def test_projections_of_idr_and_neus(tmp_path: Path, name: str, factor: float) -> None:
    """Pixels of the cameras are those of world_mat · scale_mat, whatever the factor of the matrix."""
    scale = np.diag([2.5, 2.5, 2.5, 1.0])
    scale[:3, 3] = [3.0, -1.0, 7.0]
    arrays: dict[str, np.ndarray] = {}
    expected = []
    for number, (turn, move) in enumerate(poses(12)):  # the matrices of 10 and 11 follow those of 1 in the alphabet
        ball = K @ np.concatenate((turn, move[:, None]), 1)
        world = np.eye(4)
        world[:3] = factor * ball @ np.linalg.inv(scale)
        arrays |= {
            f"world_mat_{number}": world.astype(np.float32) if number % 2 else world,
            f"scale_mat_{number}": scale,
        }
        arrays[f"world_mat_inv_{number}"] = np.linalg.inv(world)
        expected.append((turn, move, ball))
    np.savez(tmp_path / name, **arrays)
    for folder in ("image", "mask"):
        (tmp_path / folder).mkdir()
        for number in range(12):
            (tmp_path / folder / f"{number:03}.png").touch()
    assert find_camera_file(tmp_path) == tmp_path / name
    found = read_camera_file(tmp_path / name)
    assert [image.name for image in found.images] == [f"image/{number:03}.png" for number in range(12)]
    assert found.images[3].mask == "mask/003.png"
    points = np.random.default_rng(1).uniform(-0.6, 0.6, (20, 3))
    camera = nr.Camera.load(tmp_path / name, SIZE)
    pixels, depth = camera.project(torch.from_numpy(points).float())
    for number, (turn, move, ball) in enumerate(expected):
        image = found.images[number]
        close = {"rtol": 1e-3, "atol": 1e-4} if number % 2 else {"rtol": 1e-8, "atol": 1e-8}
        torch.testing.assert_close(image.rotation, torch.from_numpy(turn), **close)
        torch.testing.assert_close(image.translation, torch.from_numpy(move), **close)
        torch.testing.assert_close(
            torch.tensor(image.lens.intrinsics(SIZE)), torch.from_numpy(K), rtol=1e-3, atol=1e-2, check_dtype=False
        )
        np.testing.assert_allclose(pixels[number], projected(ball, points), rtol=0, atol=0.05)
        np.testing.assert_allclose(depth[number], (points @ turn.T + move)[:, 2], rtol=1e-4)


def test_damaged_projections(tmp_path: Path) -> None:
    path = tmp_path / "cameras.npz"
    refused: list[tuple[dict[str, Any], str]] = [
        ({"other": np.eye(4)}, "expected the key world_mat_0, got 'other'"),
        ({"world_mat_0": np.eye(3)}, r"world_mat_0: expected 4 x 4 finite numbers, got \[3, 3\]"),
        ({"world_mat_0": np.full((4, 4), np.nan)}, "world_mat_0: expected 4 x 4 finite numbers"),
        ({"world_mat_0": np.array([["x"] * 4] * 4)}, "world_mat_0: expected 4 x 4 finite numbers"),
        ({"world_mat_0": np.array([[None] * 4] * 4)}, "world_mat_0: expected 4 x 4 finite numbers"),
        ({"world_mat_0": np.eye(4) + 1j}, "world_mat_0: expected 4 x 4 finite numbers"),
        ({"world_mat_0": np.zeros((4, 4))}, "world_mat_0: expected a projection with perspective"),
        ({"world_mat_0": np.eye(4), "scale_mat_0": np.zeros((4, 4))}, "world_mat_0: expected a projection with"),
        ({"world_mat_0": np.zeros((4, 1 << 12))}, "world_mat_0: expected 4 x 4 finite numbers"),
    ]
    for arrays, sentence in refused:
        np.savez(path, **arrays)
        with pytest.raises(ValueError, match=rf"cameras\.npz: {sentence}"):
            read_camera_file(path)
    for data in (b"", b"PK\3\4 no archive", b"text"):
        path.write_bytes(data)
        with pytest.raises(ValueError, match=r"cameras\.npz: expected matrices saved by NumPy \(npz\)"):
            read_camera_file(path)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("world_mat_0.npy", b"no array")
    with pytest.raises(ValueError, match=r"cameras\.npz: world_mat_0: expected 4 x 4 finite numbers"):
        read_camera_file(path)
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (1 << 45,)})
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("world_mat_0.npy", header.getvalue())
    with pytest.raises(ValueError, match=r"cameras\.npz: world_mat_0: expected 4 x 4 finite numbers"):
        read_camera_file(path)


def test_the_directory_of_projections_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It was read for each matrix: 4,000 of them, in 0.8 MB, took more than 50 s."""
    opened: list[Any] = []
    before = zipfile.ZipFile.__init__
    monkeypatch.setattr(zipfile.ZipFile, "__init__", lambda self, *a, **k: (opened.append(a), before(self, *a, **k))[1])
    np.savez(tmp_path / "cameras.npz", **{f"world_mat_{number}": np.eye(4) for number in range(50)})
    opened.clear()
    assert len(read_camera_file(tmp_path / "cameras.npz").images) == 50 and len(opened) == 1


def test_cameras_of_bop(tmp_path: Path) -> None:
    rows = {}
    for number, (turn, move) in zip((0, 7, 12), poses(3), strict=True):
        row = {"cam_K": K.reshape(-1).tolist(), "depth_scale": 0.1, "view_level": 1}
        rows[str(number)] = {**row, "cam_R_w2c": turn.reshape(-1).tolist(), "cam_t_w2c": (1000 * move).tolist()}
    path = tmp_path / "scene_camera.json"
    path.write_text(json.dumps(rows))
    (tmp_path / "rgb").mkdir()
    assert find_camera_file(tmp_path) == path
    assert [image.name for image in read_camera_file(path).images] == ["rgb/000000", "rgb/000007", "rgb/000012"]
    points = np.random.default_rng(1).uniform(-600, 600, (20, 3))  # millimetres
    pixels, depth = nr.Camera.load(path, SIZE).project(torch.from_numpy(points).float())
    for number, (turn, move) in enumerate(poses(3)):
        expected = projected(K @ np.concatenate((turn, 1000 * move[:, None]), 1), points)
        np.testing.assert_allclose(pixels[number], expected, rtol=0, atol=0.01)
        np.testing.assert_allclose(depth[number], (points @ turn.T + 1000 * move)[:, 2], rtol=1e-4)
    path.write_text(json.dumps({"1": {"cam_K": K.reshape(-1).tolist(), "depth_scale": 1.0}}))
    with pytest.warns(
        UserWarning, match=r"scene_camera\.json: 1 images have no cam_R_w2c; their cameras are at the origin"
    ):
        camera = nr.Camera.load(path, SIZE)
    assert torch.equal(camera.axes[0], torch.diag(torch.tensor([1.0, -1.0, 1.0])))
    for row, sentence in (
        ({"1": {"cam_K": [1, 2, 3]}}, "image '1': cam_K: expected 9 finite numbers"),
        (
            {"1": {"cam_K": rows["0"]["cam_K"], "cam_R_w2c": [1] * 9, "cam_t_w2c": [0] * 3}},
            "image '1': cam_R_w2c: expected a",
        ),
        ({"x": {"cam_K": rows["0"]["cam_K"]}}, "image 'x': expected the number of an image"),
        ({"0": rows["0"], "1": 5}, "image '1': expected the number of an image"),
    ):
        path.write_text(json.dumps(row))
        with pytest.raises(ValueError, match=rf"scene_camera\.json: {sentence}"):
            read_camera_file(path)


POSE = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 3], [0, 0, 0, 1]]
NGP = {"fl_x": 200, "fl_y": 201, "cx": 320, "cy": 240, "w": 640, "h": 480, "k1": 0.1, "k2": 0.01, "k3": 0.0, "k4": 0.0}


def test_fisheye_of_instant_ngp(tmp_path: Path) -> None:
    path, frames = tmp_path / "transforms.json", [{"file_path": "a.png", "transform_matrix": POSE}]
    path.write_text(json.dumps({**NGP, "is_fisheye": True, "aabb_scale": 4, "frames": frames}))
    camera = nr.Camera.load(path)
    assert camera.is_fisheye and camera.dist_coeffs is not None
    torch.testing.assert_close(camera.dist_coeffs[0], torch.tensor([0.1, 0.01, 0.0, 0.0]))
    turned = torch.tensor([[1.0, 0, 0], [0, -1, 0], [0, 0, -1]])
    same = nr.Camera.fisheye(
        [[200.0, 0, 320], [0, 201, 240], [0, 0, 1]], turned, (0.0, 0.0, 3.0), (0.1, 0.01, 0.0, 0.0), SIZE
    )
    points = torch.randn(9, 3, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(camera.project(points), same.project(points))
    path.write_text(json.dumps({**NGP, "is_fisheye": False, "camera_model": "OPENCV", "frames": frames}))
    assert not nr.Camera.load(path).is_fisheye
    for key, value, sentence in (
        ("is_fisheye", "yes", "is_fisheye: expected true or false, got 'yes'"),
        ("ftheta_p0", 0.1, "ftheta_p0: expected a pinhole, OPENCV or fisheye lens"),
        ("equirectangular", True, "equirectangular: expected a pinhole, OPENCV or fisheye lens"),
    ):
        path.write_text(json.dumps({**NGP, key: value, "frames": frames}))
        with pytest.raises(ValueError, match=rf"transforms\.json: image 0: {sentence}"):
            nr.Camera.load(path)


TURN, SQUARE = [[1, 0, 0], [0, 1, 0], [0, 0, 1]], [[50, 0, 32], [0, 51, 24], [0, 0, 1]]
PLACE = {"K": SQUARE, "R": TURN, "t": [0, 0, 3], "width": 64, "height": 48}
GOOD: dict[str, Any] = {
    "transforms": {**NGP, "is_fisheye": True, "frames": [{"file_path": "a.png", "transform_matrix": POSE}] * 2},
    "angle": {
        "camera_angle_x": 0.8,
        "frames": [{"file_path": "a.png", "transform_matrix": POSE, "mask_path": "b.png"}],
    },
    "views": {"K": SQUARE, "dist": [0.1, 0, 0, 0], "views": [{"file": "a.png", "R": TURN, "t": [0, 0, 3]}]},
    "named": {"K": SQUARE, "a.png": {"R": TURN, "t": [0, 0, 3]}},
    "angles": {"viewing_angle": 30, "views": [{"file": "a.png", "azimuth": 3, "elevation": 20, "distance": 2.7}]},
    "one": {**PLACE, "dist_coeffs": [0.1, 0, 0, 0, 0]},
    "fisheye": {**PLACE, "fisheye": True, "dist_coeffs": [0.1, 0, 0, 0]},
    "matrix": {"cameras": [{"camera_to_world": POSE, "convention": "blender", "viewing_angle": 20}]},
    "clip": {"clip": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1, -0.2], [0, 0, -1, 0]]},
    "eye": {"eye": [0, 0, 3], "direction": [0, 0, -1], "up": [0, 1, 0], "viewing_angle": 20},
    "saved": {"rotation": TURN, "origin": [0, 0, 1], "translation": [0, 0, 0], "K": SQUARE, "orig_size": [48, 64]},
    "bop": {
        "0": {
            "cam_K": [50, 0, 32, 0, 51, 24, 0, 0, 1],
            "cam_R_w2c": [1, 0, 0, 0, 1, 0, 0, 0, 1],
            "cam_t_w2c": [0, 0, 300],
        }
    },
}
ODD: list[Any] = [
    None, True, 0, -1, 0.5, 1e400, float("nan"), "", "x" * 300, [], {}, [1], [[1]], [[1, 2], [3]], {"a": 1}, 2**70,
    [None], ["x"],
]  # fmt: skip
# Words of Python, torch and NumPy that say nothing of a file.
PYTHON = re.compile(
    r"index out|has no attribute|subscriptable|argument|unhashable|convert|literal|unpack|must be|NoneType|not iterable"
    r"|keyword|broadcast|dimension|sequence|infer dtype|tensor|not supported|__|Boolean value|Overflow|'list'"
    r"|'dict'|'str'"
)


def places(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    keys = list(value) if isinstance(value, dict) else list(range(len(value))) if isinstance(value, list) else []
    return [path, *(place for key in keys for place in places(value[key], (*path, key)))]


def damaged(content: Any, numbers: random.Random) -> Any:
    """Take away or replace some values of a JSON file."""
    content = copy.deepcopy(content)
    for _ in range(numbers.choice([1, 1, 2, 3])):
        place = numbers.choice(places(content)[1:] or [()])
        if not place:
            break
        owner = content
        for key in place[:-1]:
            owner = owner[key]
        if numbers.random() < 0.3:
            del owner[place[-1]]
        else:
            owner[place[-1]] = copy.deepcopy(numbers.choice(ODD))
    return content


@pytest.mark.parametrize("name", GOOD)
def test_damaged_files_never_show_words_of_python(tmp_path: Path, name: str) -> None:
    path, numbers = tmp_path / "cameras.json", random.Random(0)
    path.write_text(json.dumps(GOOD[name]))
    load_cameras(path, (48, 64))
    for _ in range(150):
        path.write_text(json.dumps(damaged(GOOD[name], numbers)))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            try:
                load_cameras(path, (48, 64))
            except ValueError as error:
                message = str(error).removeprefix(str(path))
                assert message != str(error) and "expected" in message and not PYTHON.search(message), message
