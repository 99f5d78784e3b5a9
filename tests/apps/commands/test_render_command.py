"""`render` with camera files, several meshes, a photograph behind them, and files of single outputs."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

import neural_renderer as nr
from neural_renderer.apps import command_line as cli
from tests.rounding import STEP

K = [[80.0, 0.0, 34.0], [0.0, 78.0, 22.0], [0.0, 0.0, 1.0]]
R = [[1.0, 0.0, 0.0], [0.0, -0.8, 0.6], [0.0, -0.6, -0.8]]  # from above, down to the origin
T = [0.1, 0.0, 3.0]
SIZE = {"width": 64, "height": 48}
ROUND = [0.05, -0.01, 0.002, 0.0]
CAMERA = nr.Camera.projection(K, R, T, orig_size=(48, 64))
POSE = torch.eye(4)
POSE[:3, :3] = torch.tensor(R).T * torch.tensor([1.0, -1.0, -1.0])
POSE[:3, 3] = -torch.tensor(R).T @ torch.tensor(T)
NERF = {"fl_x": 80, "fl_y": 78, "cx": 34, "cy": 22, "w": 64, "h": 48}
LENS = {"viewing_angle": 20}
LOOK = nr.Camera.look((0.5, 1.0, -3.0), (-0.1, -0.3, 1.0), viewing_angle=20)
FORMATS: dict[str, tuple[dict[str, Any], nr.Camera]] = {
    "K, R, t": ({"K": K, "R": R, "t": T, **SIZE}, CAMERA),
    "several": ({"cameras": [{"K": K, "R": R, "t": T, "file": "no.png", **SIZE}]}, CAMERA),
    "fisheye": (
        {"K": K, "R": R, "t": T, "dist_coeffs": ROUND, "fisheye": True, **SIZE},
        nr.Camera.fisheye(K, R, T, ROUND, orig_size=(48, 64)),
    ),
    "a matrix": ({"camera_to_world": POSE.tolist(), "convention": "blender", "K": K, **SIZE}, CAMERA),
    "an angle": (
        {"camera_to_world": POSE.tolist(), "convention": "opengl", **LENS, **SIZE},
        nr.Camera.from_matrix(camera_to_world=POSE, convention="opengl", **LENS),
    ),
    "clip": ({"clip": torch.eye(4)[[0, 1, 3, 2]].tolist(), **SIZE}, nr.Camera.from_clip(torch.eye(4)[[0, 1, 3, 2]])),
    "nerf": ({**NERF, "frames": [{"file_path": "no", "transform_matrix": POSE.tolist()}]}, CAMERA),
    "nerf's fisheye": (
        {
            **NERF,
            **dict(zip(("k1", "k2", "k3", "k4"), ROUND, strict=True)),
            "camera_model": "OPENCV_FISHEYE",
            "frames": [{"file_path": "no", "transform_matrix": POSE.tolist()}],
        },
        nr.Camera.fisheye(K, R, T, ROUND, orig_size=(48, 64)),
    ),
    "angles": (
        {"viewing_angle": 20, "views": [{"file": "no", "azimuth": 30, "elevation": 10, "distance": 3}]},
        nr.Camera.look_at(nr.get_points_from_angles(3.0, 10.0, 30.0), viewing_angle=20),
    ),
    "fit's report": (
        {"recover": "camera", "camera": {"eye": [0.5, 1, -3], "direction": [-0.1, -0.3, 1], "up": [0, 1, 0], **LENS}},
        LOOK,
    ),
    "eye": ({"eye": [0.5, 1, -3], **LENS, **SIZE}, nr.Camera.look_at((0.5, 1.0, -3.0), **LENS)),
    "eye and at": (
        {"eye": [0.5, 1, -3], "at": [0.1, 0, 0], **LENS, **SIZE},
        nr.Camera.look_at((0.5, 1.0, -3.0), (0.1, 0.0, 0.0), **LENS),
    ),
}


@pytest.fixture
def meshes(tmp_path: Path) -> list[str]:
    """A ball at the origin, and a box beside it, farther away."""
    vertices, faces = nr.cube()
    nr.Mesh(*nr.icosphere(2, 0.5), face_colors=torch.rand(320, 3)).save(tmp_path / "ball.glb")
    nr.Mesh(0.3 * vertices + torch.tensor([0.5, 0.2, 0.4]), faces, face_colors=torch.rand(12, 3)).save(
        tmp_path / "box.glb"
    )
    return [str(tmp_path / "ball.glb"), str(tmp_path / "box.glb")]


def scene(meshes: list[str]) -> nr.UVMesh:
    return nr.join([nr.UVMesh.load(path) for path in meshes])


def run(*arguments: object) -> None:
    assert cli.main(["render", *map(str, arguments)]) == 0


def fails(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The one sentence of a command that ends with 1."""
    assert cli.main(["render", *map(str, arguments)]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    return said


@pytest.mark.parametrize("name", FORMATS)
def test_camera_files(name: str, meshes: list[str], tmp_path: Path) -> None:
    given, camera = FORMATS[name]
    (tmp_path / "a.json").write_text(json.dumps(given))
    own = () if "width" in given or "w" in given else ("--size", "48", "64")
    run(*meshes, "--camera", tmp_path / "a.json", "--save", "depth", tmp_path / "d.npy", *own)
    depth = np.load(tmp_path / "d.npy")
    expected = nr.render(scene(meshes), camera, (48, 64), outputs=("depth",), anti_aliasing=False, near=1e-3).depth[0]
    expected = torch.where(expected < 100, expected, 0.0).numpy()
    assert depth.shape == (48, 64) and (depth > 0).any()
    # Files and matrices are rounded; a pixel whose centre is on an edge may show either face.
    assert (np.abs(depth - expected) > 1e-3).mean() < 5e-3


def test_outputs(meshes: list[str], tmp_path: Path) -> None:
    exr = pytest.importorskip("OpenEXR")
    names = ("rgb", "alpha", "depth", "normal", "position", "uv", "face_index", "barycentric")
    (tmp_path / "a.json").write_text(json.dumps(FORMATS["K, R, t"][0]))
    camera = ("--camera", tmp_path / "a.json", "--no-light", "--background", "black")
    for suffix in (".npy", ".exr"):
        run(*meshes, *camera, "--save", *(part for name in names for part in (name, tmp_path / (name + suffix))))
    drawn = nr.render(
        scene(meshes), CAMERA, (48, 64), outputs=names, anti_aliasing=False, shading="smooth", light=None, near=1e-3
    )
    mask = drawn.face_index[0] >= 0
    for name in names:
        array = np.load(tmp_path / f"{name}.npy")
        expected = getattr(drawn, name)[0]
        expected = expected.movedim(0, 2) if expected.dim() == 3 else expected
        assert array.shape == expected.shape and array.dtype == (np.int32 if name == "face_index" else np.float32)
        off = np.abs(array - expected.numpy())[mask.numpy()]
        if name not in ("rgb", "alpha"):  # these two are anti-aliased
            assert (off > 1e-4).mean() < 5e-3
            assert (array[~mask.numpy()] == (-1 if name == "face_index" else 0)).mean() > 0.99
        with exr.File(str(tmp_path / f"{name}.exr"), separate_channels=True) as image:
            channels = {key: channel.pixels for key, channel in image.channels().items()}
        keys = {
            "rgb": "RGB",
            "alpha": "A",
            "depth": "Z",
            "uv": ("uv.U", "uv.V"),
            "face_index": ("face_index",),
        }.get(name, [f"{name}.{axis}" for axis in "XYZ"])
        stacked = np.stack([channels[key] for key in keys], -1).reshape(array.shape)
        assert np.array_equal(stacked, array.astype(np.float32)) and len(channels) == len(keys)


def test_pictures_of_outputs(meshes: list[str], tmp_path: Path) -> None:
    (tmp_path / "a.json").write_text(json.dumps(FORMATS["K, R, t"][0]))
    depth, normal, plain = tmp_path / "d.png", tmp_path / "n.png", tmp_path / "d.npy"
    common = (*meshes, "--camera", tmp_path / "a.json")
    run(*common, "-o", tmp_path / "a.png", "--save", "depth", depth, "normal", normal, "--depth-scale", "5000")
    run(*common, "--save", "depth", plain)
    with Image.open(depth) as image:
        assert image.mode in ("I;16", "I") and image.size == (64, 48)
        steps = np.asarray(image).astype(np.float64)
    assert np.abs(steps / 5000 - np.load(plain)).max() <= 0.5 / 5000 + 1e-6 and steps.max() > 5000
    picture = nr.load_image(normal)
    assert torch.allclose(picture[0, 0], torch.full((3,), 0.5), atol=STEP)  # the normal 0
    assert nr.load_image(tmp_path / "a.png").shape == (48, 64, 3)


def test_a_photograph_behind(meshes: list[str], tmp_path: Path) -> None:
    photo = torch.rand(3, 30, 40)
    nr.save_image(tmp_path / "photo.png", photo)
    run(meshes[0], "-o", tmp_path / "a.png", "--background", tmp_path / "photo.png", "--viewing-angle", "40")
    picture = nr.load_image(tmp_path / "a.png")
    assert picture.shape == (30, 40, 3)
    assert torch.allclose(picture[0, :5], photo[:, 0, :5].T, atol=1.01 * STEP)
    run(meshes[0], "-o", tmp_path / "b.png", "--background", tmp_path / "photo.png", "--size", "60", "80")
    assert nr.load_image(tmp_path / "b.png").shape == (60, 80, 3)


def test_several_meshes_are_one_scene(meshes: list[str], tmp_path: Path) -> None:
    run(*meshes, "-o", tmp_path / "a.png", "--size", "32")
    run(*meshes, "-o", tmp_path / "b.png", "--size", "32", "--texture-size", "2")
    picture, baked = nr.load_image(tmp_path / "a.png"), nr.load_image(tmp_path / "b.png")
    assert (picture - baked).abs().mean() < 0.05
    run(meshes[0], "-o", tmp_path / "c.png", "--size", "32")
    assert (picture - nr.load_image(tmp_path / "c.png")).abs().mean() > 0.02


def test_an_animation_shows_all_cameras(meshes: list[str], tmp_path: Path) -> None:
    views = [{"azimuth": a, "elevation": 10, "distance": 3, "file": "no"} for a in (0, 40, 80)]
    (tmp_path / "cameras.json").write_text(json.dumps({"views": views}))
    run(*meshes, "--camera", tmp_path, "-o", tmp_path / "a.gif", "--size", "24")
    with Image.open(tmp_path / "a.gif") as animation:
        assert animation.n_frames == 3
    run(*meshes, "--camera", tmp_path, "-o", tmp_path / "a.png", "--frame", "2", "--size", "24")
    run(*meshes, "--camera", tmp_path, "-o", tmp_path / "b.png", "--size", "24")
    assert (nr.load_image(tmp_path / "a.png") - nr.load_image(tmp_path / "b.png")).abs().max() > 0.1


def test_errors(meshes: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ball, path = meshes[0], tmp_path / "a.json"

    def about(given: object, *options: object) -> str:
        path.write_text(json.dumps(given))
        return fails(capsys, ball, "--camera", path, "-o", tmp_path / "x.png", *options)

    full = FORMATS["K, R, t"][0]
    assert "a.json: image 0: expected the keys K, R, t, dist_coeffs, fisheye, got 'k1'" in about({**full, "k1": 3})
    assert "image 0: R: expected a rotation matrix" in about({**full, "R": K})
    assert "expected the keys width and height, or a size" in about({"K": K, "R": R, "t": T})
    assert "expected width and height in pixels, got 0 and 48" in about({**full, "width": 0})
    assert 'expected the key "frames" (NeRF) or "views", got neither' in about({"k": 1})
    assert "--frame: expected less than 1, the number of cameras, got 4" in about(full, "--frame", "4")
    assert "all of it behind" in about({**full, "t": [0, 0, -9]})
    assert "--turntable: expected a turntable or --camera, got both" in fails(
        capsys, ball, "--camera", path, "-o", tmp_path / "x.gif", "--turntable", "4"
    )
    assert "--frame: expected --camera with it, got frame 2" in fails(
        capsys, ball, "-o", tmp_path / "x.png", "--frame", "2"
    )
    named = ("-o", tmp_path / "x.png", "--background", "environment")
    assert "--background environment: expected --environment" in fails(capsys, ball, *named)
    assert "--environment: expected it with light" in fails(capsys, ball, *named, "--environment", "a", "--no-light")
    assert "--output: expected a picture to write, or --save" in fails(capsys, ball)
    said = fails(capsys, ball, "--save", "uv", tmp_path / "uv.png")
    assert "--save uv: expected a name that ends in .npy, .exr, got 'uv.png'" in said
    assert "--depth-scale: expected at most" in fails(
        capsys, ball, "--save", "depth", tmp_path / "d.png", "--depth-scale", "1e6"
    )
    nr.save_image(tmp_path / "photo.png", torch.rand(3, 8, 8))
    behind = ("--background", tmp_path / "photo.png", "--save", "rgb", tmp_path / "photo.png")
    assert "which is an input" in fails(capsys, ball, *behind)
    path.unlink()
    assert "a.json: expected a folder of images or a camera file" in fails(
        capsys, ball, "--camera", path, "-o", tmp_path / "x.png"
    )


def test_shading_and_environments(meshes: list[str], tmp_path: Path) -> None:
    sky = torch.rand(8, 16, 3)
    nr.save_image(tmp_path / "sky.png", sky)
    (tmp_path / "a.json").write_text(json.dumps(FORMATS["K, R, t"][0]))
    common = (*meshes, "--camera", tmp_path / "a.json")
    surroundings = ("--environment", tmp_path / "sky.png", "--background", "environment", "--shading", "pbr")
    run(*common, *surroundings, "--save", "rgb", tmp_path / "a.npy", "-o", tmp_path / "a.png")
    light = nr.EnvironmentLight.load(tmp_path / "sky.png")
    behind = light.background(CAMERA, (48, 64))
    options = {"light": light, "shading": "pbr", "near": 1e-3}
    expected = nr.render(scene(meshes), CAMERA, (48, 64), background=behind, **options).rgb[0].movedim(0, 2)
    found = torch.from_numpy(np.load(tmp_path / "a.npy"))
    assert ((found - expected).abs() > 1e-3).float().mean() < 5e-3
    assert ((nr.load_image(tmp_path / "a.png") - expected.clamp(0, 1)).abs() > 3e-3).float().mean() < 5e-3
    vertices, faces = nr.icosphere(1)
    nr.UVMesh(vertices, faces, vertices[:, :2], sky).save(tmp_path / "ball.obj")  # faces share vertices
    run(tmp_path / "ball.obj", "--size", "32", "--shading", "smooth", "-o", tmp_path / "b.png")
    run(tmp_path / "ball.obj", "--size", "32", "--shading", "flat", "-o", tmp_path / "c.png")
    assert (nr.load_image(tmp_path / "b.png") - nr.load_image(tmp_path / "c.png")).abs().max() > 0.02


def test_layers(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    vertices, faces = nr.icosphere(1)
    glass = (nr.Material("glass", opacity=0.25, alpha_mode="BLEND"),)
    nr.UVMesh(vertices, faces, vertices[:, :2], torch.ones(2, 2, 3), materials=glass).save(tmp_path / "glass.glb")
    common = (tmp_path / "glass.glb", "--size", "24", "--no-light", "--background", "0", "0", "0")
    run(*common, "--layers", "2", "--save", "rgb", tmp_path / "a.npy", "rgb", tmp_path / "a.png")  # twice: both
    inside = np.load(tmp_path / "a.npy")[10:14, 10:14]
    np.testing.assert_allclose(inside, 1 - 0.75**2, rtol=0, atol=1e-4)  # the front and the back
    np.testing.assert_allclose(nr.load_image(tmp_path / "a.png")[10:14, 10:14], inside, rtol=0, atol=STEP)
    assert "--layers: expected at least 1, got 0" in fails(capsys, *common, "--layers", "0", "-o", tmp_path / "b.png")
    baked = ("--layers", "2", "--texture-size", "2", "-o", tmp_path / "b.png")
    assert "--layers: expected the materials of the file" in fails(capsys, *common, *baked)
    other = ("--layers", "2", "--mode", "normals", "-o", tmp_path / "b.png")
    assert "--layers: expected --mode rgb, got normals" in fails(capsys, *common, *other)


def test_a_picture_may_be_called_as_a_key_of_its_camera_file(meshes: list[str], tmp_path: Path) -> None:
    """Drawn twice: "K" is no file of the camera file."""
    (tmp_path / "a.json").write_text(json.dumps(FORMATS["K, R, t"][0]))
    for _ in range(2):
        run(*meshes, "--camera", tmp_path / "a.json", "-o", tmp_path / "k.png", "--size", "24")


def test_a_missing_extra_is_named(
    meshes: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "OpenEXR", None)
    said = fails(capsys, meshes[0], "--save", "depth", tmp_path / "d.exr")
    advice = 'pip install "neural-renderer[exr]"'
    assert said == f"expected OpenEXR to be installed to write {tmp_path / 'd.exr'} ({advice})\n"
    assert "No module named 'thing' (--debug" in cli._message(
        ModuleNotFoundError("No module named 'thing'", name="thing")
    )


def test_several_models_get_a_picture_each(meshes: list[str], tmp_path: Path) -> None:
    """Names or a folder tell them apart; one name draws one scene, as before."""
    for name in ("ball", "box"):
        run(tmp_path / f"{name}.glb", "-o", tmp_path / "alone" / f"{name}.png", "--size", "24")
    run(*meshes, "-o", tmp_path / "folder", "--size", "24")
    run(tmp_path, "-o", tmp_path / "names" / "of %s.png", "--size", "24", "--save", "depth", tmp_path / "%s.npy")
    for name in ("ball", "box"):
        expected = (tmp_path / "alone" / f"{name}.png").read_bytes()
        assert (tmp_path / "folder" / f"{name}.png").read_bytes() == expected
        assert (tmp_path / "names" / f"of {name}.png").read_bytes() == expected
        assert np.load(tmp_path / f"{name}.npy").shape == (24, 24)
    run(*meshes, "-o", tmp_path / "100%.png", "--size", "24")
    assert (tmp_path / "100%.png").is_file()


@pytest.mark.parametrize(
    ("output", "first", "last"),
    [
        ("%02d.png", "00.png", "02.png"),
        ("a %d of 3.jpg", "a 0 of 3.jpg", "a 2 of 3.jpg"),
        ("new", "000.png", "002.png"),
    ],
)
def test_numbered_pictures_of_a_turntable(
    output: str, first: str, last: str, meshes: list[str], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    run(meshes[1], "-o", out / output, "--turntable", "3", "--size", "24", "--azimuth", "30")
    folder = out / output if output == "new" else out
    assert len(list(folder.iterdir())) == 3
    for name, azimuth in ((first, 30), (last, 270)):
        run(meshes[1], "-o", tmp_path / f"one{Path(name).suffix}", "--size", "24", "--azimuth", azimuth)
        one, of_many = (nr.load_image(path) for path in (tmp_path / f"one{Path(name).suffix}", folder / name))
        assert (one - of_many).abs().max() < 1.01 * STEP  # angles of float64 and float32


def test_numbered_pictures_of_several_models_and_of_cameras(meshes: list[str], tmp_path: Path) -> None:
    run(*meshes, "-o", tmp_path / "out", "--turntable", "2", "--size", "16")
    assert sorted(path.name for path in (tmp_path / "out" / "box").iterdir()) == ["000.png", "001.png"]
    cameras = {"cameras": [{"eye": [0, 1, -3], **LENS}, {"eye": [0, 1, 3], **LENS}]}
    (tmp_path / "a.json").write_text(json.dumps(cameras))
    run(*meshes, "-o", tmp_path / "%d.png", "--camera", tmp_path / "a.json", "--size", "24")
    for number in range(2):
        run(*meshes, "-o", tmp_path / "x.png", "--camera", tmp_path / "a.json", "--frame", number, "--size", "24")
        assert (tmp_path / "x.png").read_bytes() == (tmp_path / f"{number}.png").read_bytes()


def test_each_camera_of_a_file_has_its_own_size(
    meshes: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    both = [{"K": K, "R": R, "t": T, "width": 32, "height": height} for height in (32, 16)]
    for name, content in (("both", {"cameras": both}), ("last", both[1])):
        (tmp_path / f"{name}.json").write_text(json.dumps(content))
    run(*meshes, "-o", tmp_path / "%d.png", "--camera", tmp_path / "both.json")
    run(*meshes, "-o", tmp_path / "frame.png", "--camera", tmp_path / "both.json", "--frame", "1")
    run(*meshes, "-o", tmp_path / "last.png", "--camera", tmp_path / "last.json")
    one, frame, last = ((tmp_path / f"{name}.png").read_bytes() for name in ("1", "frame", "last"))
    assert one == frame == last  # the heights are powers of two, so that K is exact in both
    assert nr.load_image(tmp_path / "0.png").shape[:2] == (32, 32)
    capsys.readouterr()
    said = fails(capsys, *meshes, "-o", tmp_path / "a.gif", "--camera", tmp_path / "both.json")
    assert "expected one size, --size or numbers such as %03d.png, got 32 x 16 and 32 x 32" in said
    run(*meshes[:1], "-o", tmp_path / "folder/", "--camera", tmp_path / "both.json")
    assert sorted(path.name for path in (tmp_path / "folder").iterdir()) == ["000.png", "001.png"]
    assert [nr.load_image(tmp_path / "folder" / f"00{n}.png").shape[0] for n in range(2)] == [32, 16]
    run(*meshes[:1], "-o", tmp_path / "frame/", "--camera", tmp_path / "both.json", "--frame", "1")
    run(*meshes[:1], "-o", tmp_path / "frame/", "--camera", tmp_path / "last.json")
    assert [path.name for path in (tmp_path / "frame").iterdir()] == [f"{Path(meshes[0]).stem}.png"]


def test_models_that_cannot_be_drawn_are_named_and_the_others_drawn(
    meshes: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "bad.obj").write_text("v 1 2\n")
    said = fails(capsys, tmp_path, "-o", tmp_path / "out", "--size", "16")
    assert said.startswith(f"{tmp_path / 'bad.obj'} is not drawn: ") and (tmp_path / "out" / "box.png").is_file()
    (tmp_path / "other").mkdir()
    assert "expected a folder with mesh files, got none" in fails(capsys, tmp_path / "other", "-o", tmp_path / "%s.png")
    (tmp_path / "other" / "ball.ply").write_text("")
    same = fails(capsys, *meshes, tmp_path / "other", "-o", tmp_path / "out", "--size", "16")
    assert same == "MESH: expected models with different names, got two that are called ball\n"
    assert "got 'x.png'" in fails(capsys, tmp_path, "-o", tmp_path / "x.png")
    assert "for the name of each model, got 'd.npy'" in fails(
        capsys, *meshes, "-o", tmp_path / "%s.png", "--save", "depth", tmp_path / "d.npy"
    )
    assert "--save: expected a picture as --output" in fails(
        capsys, meshes[0], "-o", tmp_path / "%d.png", "--save", "depth", tmp_path / "d.npy"
    )
    texture = tmp_path / "a_texture.png"
    nr.Mesh(*nr.cube(), torch.rand(12, 2, 2, 2, 3)).save(tmp_path / "a.obj")
    texture.rename(tmp_path / "000.png")
    material = (tmp_path / "a.mtl").read_text().replace("a_texture.png", "000.png")
    (tmp_path / "a.mtl").write_text(material)
    assert "000.png, which " in fails(capsys, tmp_path / "a.obj", "-o", tmp_path / "%03d.png", "--size", "16")


def test_smooth_bodies_are_smooth_and_furniture_is_not(meshes: list[str], tmp_path: Path) -> None:
    """By default; normals in the file count first."""
    vertices, faces = nr.icosphere(2)
    nr.save_mesh(tmp_path / "ball.obj", vertices, faces)
    nr.save_mesh(tmp_path / "cube.obj", *nr.cube())
    corners = nr.cube()[0]
    text = (tmp_path / "cube.obj").read_text()
    lines = [f"vn {x} {y} {z}" for x, y, z in corners.tolist()]
    faced = [" ".join(["f", *(f"{part}//{part}" for part in line.split()[1:])]) if line.startswith("f ") else line
             for line in text.splitlines()]  # fmt: skip
    (tmp_path / "pillow.obj").write_text("\n".join([*lines, *faced]) + "\n")
    for name, expected in (("ball", "smooth"), ("cube", "flat"), ("pillow", "smooth")):
        pictures = []
        for shading in ((), ("--shading", "smooth"), ("--shading", "flat")):
            run(tmp_path / f"{name}.obj", "-o", tmp_path / "a.png", "--size", "32", *shading)
            pictures.append((tmp_path / "a.png").read_bytes())
        assert pictures[1] != pictures[2]
        assert pictures[0] == pictures[1 if expected == "smooth" else 2], name
