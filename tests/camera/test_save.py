"""Cameras in files: as JSON, and through torch.save and torch.load."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

import neural_renderer as nr
from neural_renderer.camera.files.read import read_camera_file

EYES = torch.tensor([[0.1, 1.0, -2.5], [2.0, 0.3, 1.0], [-1.0, 0.7, 2.2]])
K = torch.tensor([[500.0, 0.3, 320.0], [0.0, 510.0, 241.5], [0.0, 0.0, 1.0]])
TURNS = nr.rotations.from_axis_angle(EYES)
SIZE = (480, 640)
CAMERAS = {
    "angle": nr.Camera.look_at(EYES),
    "angles": nr.Camera.look_at(EYES, viewing_angle=torch.tensor([20.0, 30.1, 40.0])),
    "mirrored": nr.Camera.look_at(EYES, mirrored=True),
    "orthographic": nr.Camera.look_at(EYES, orthographic=True, scale=0.7),
    "weak": nr.Camera.weak_perspective(torch.tensor([0.8, 0.7, 0.6]), TURNS, EYES[:, :2]),
    "K": nr.Camera.projection(K, TURNS, EYES, orig_size=SIZE),
    "K of each": nr.Camera.projection(K * torch.ones(3, 1, 1), TURNS, EYES, orig_size=SIZE),
    "distortion": nr.Camera.projection(
        K, TURNS, EYES, EYES.mean() * torch.tensor([0.1, 0.02, 0.01, 0.02, 0.001]), SIZE
    ),
    "fisheye": nr.Camera.fisheye(K, TURNS, EYES, torch.tensor([0.1, 0.02, 0.01, 0.02]), SIZE),
    "clip": nr.Camera.from_clip(torch.tensor([[1.5, 0, 0, 0], [0, 2.0, 0, 0], [0, 0, 1, -0.2], [0, 0, 1, 0]])),
}


def assert_same(a: Any, b: Any) -> None:
    for part in fields(a):
        one, other = getattr(a, part.name), getattr(b, part.name)
        if isinstance(one, Tensor):
            assert isinstance(other, Tensor) and one.dtype == other.dtype and torch.equal(one, other), part.name
        else:
            assert one == other, part.name


@pytest.mark.parametrize("kind", CAMERAS)
def test_cameras_come_back_exactly(kind: str, tmp_path: Path) -> None:
    for camera in (CAMERAS[kind], CAMERAS[kind][:1]):
        camera.save(tmp_path / "new" / "cameras.json")
        assert_same(nr.Camera.load(tmp_path / "new"), camera)
        torch.save(camera, tmp_path / "c.pt")
        assert_same(torch.load(tmp_path / "c.pt", weights_only=True), camera)
    assert not list(tmp_path.rglob("*.tmp*"))


def test_a_size_makes_a_file_for_fit(tmp_path: Path) -> None:
    camera = CAMERAS["angles"]
    camera.save(tmp_path / "c.json", size=(100, 200), names=["a.png", "b.png", "c.png"])
    assert [image.name for image in read_camera_file(tmp_path / "c.json").images] == ["a.png", "b.png", "c.png"]
    found = nr.Camera.load(tmp_path / "c.json")
    points = torch.rand(5, 3, generator=torch.Generator().manual_seed(0))
    for mine, theirs in zip(found.project(points), camera.project(points, (100, 200)), strict=True):
        torch.testing.assert_close(mine, theirs, atol=1e-3, rtol=1e-5)  # pixels of a picture of 200
    CAMERAS["K"].save(tmp_path / "k.json")
    assert [row["file"] for row in json.loads((tmp_path / "k.json").read_text())["views"]][1] == "001.png"
    with pytest.raises(ValueError, match="names: expected 3 names, got 1"):
        camera.save(tmp_path / "c.json", size=(100, 200), names=["a.png"])
    assert len(nr.Camera.load(tmp_path / "c.json")) == 3  # the file stays as it was


def test_damaged_files_are_named(tmp_path: Path) -> None:
    CAMERAS["angle"].save(tmp_path / "c.json")
    content = json.loads((tmp_path / "c.json").read_text())
    content["cameras"][1]["origin"] = [1.0, "x", 2.0]
    (tmp_path / "c.json").write_text(json.dumps(content))
    with pytest.raises(ValueError, match=r"c\.json: image 1"):
        nr.Camera.load(tmp_path / "c.json")
    content["cameras"][1]["origin"] = [[1.0]]
    (tmp_path / "c.json").write_text(json.dumps(content))
    with pytest.raises(ValueError, match=r"c\.json: image 1: origin: expected 3 finite numbers"):
        nr.Camera.load(tmp_path / "c.json")
    with pytest.raises(FileNotFoundError):
        nr.Camera.load(tmp_path / "absent.json")


def test_torch_load_reads_scenes_by_default(tmp_path: Path) -> None:
    mesh = nr.Mesh.icosphere(1).trainable()
    uv_mesh = nr.UVMesh(mesh.vertices.detach(), mesh.faces, torch.rand(80, 3, 2), torch.rand(4, 4, 3))
    uv_mesh = nr.UVMesh(
        *(getattr(uv_mesh, name) for name in ("vertices", "faces", "uv")),
        torch.rand(4, 4, 3),
        materials=(nr.Material(metallic=0.3, normal_texture=nr.Texture(torch.rand(2, 2, 3))),),
    )
    camera = CAMERAS["angle"]
    lights = [nr.Light(), nr.CameraLight(), nr.PointLight((0.0, 2.0, 0.0)), nr.EnvironmentLight(torch.rand(4, 8, 3))]
    lights += [nr.SpotLight((0.0, 2.0, 0.0), direction=(0.0, -1.0, 0.0)), nr.SphericalHarmonicLight(torch.rand(9, 3))]
    scene = {"meshes": [mesh, uv_mesh], "lights": lights, "models": [nr.PBR(), nr.Phong()]}
    for one in scene["meshes"]:
        nr.render(one, camera, 16, light=lights, shading="smooth")  # fills what lights keep
    torch.save(scene, tmp_path / "scene.pt")
    found = torch.load(tmp_path / "scene.pt", weights_only=True)
    for one, other in zip(scene["meshes"], found["meshes"], strict=True):
        want = nr.render(one, camera, 16, light=lights, shading="smooth").rgb
        assert torch.equal(nr.render(other, camera, 16, light=found["lights"], shading="smooth").rgb, want)
    assert [name for name, _ in found["meshes"][0].named_parameters()] == ["vertices", "textures"]
    code = f"import neural_renderer as nr, torch; nr.Camera; torch.load({str(tmp_path / 'scene.pt')!r})"
    subprocess.run([sys.executable, "-W", "error::FutureWarning", "-c", code], check=True)
