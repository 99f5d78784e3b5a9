"""Views of a model: their files, cameras and matrices, and the same bytes everywhere."""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

import neural_renderer as nr
from neural_renderer.apps.many.cameras import CameraPlan
from neural_renderer.apps.many.models import ModelFile
from neural_renderer.apps.many.views import RenderModel, ViewSettings, check_outputs

SIZE = (40, 56)
SETTINGS = ViewSettings(("rgba.png", "depth.npy", "face_index.npy"), SIZE, CameraPlan(views=3))


@pytest.fixture
def model(tmp_path: Path) -> ModelFile:
    """A box far from the origin."""
    vertices, faces = nr.cube()
    nr.save_mesh(tmp_path / "box.obj", vertices * torch.tensor([1.0, 2.0, 4.0]) + 30, faces)
    return ModelFile("some/box", str(tmp_path / "box.obj"))


def test_cameras_and_matrices_are_those_of_the_images(model: ModelFile) -> None:
    views = RenderModel(SETTINGS)(model)
    assert [sample.key for sample in views.samples] == ["some/box_000", "some/box_001", "some/box_002"]
    mesh = nr.Mesh.load(model.path)
    for sample in views.samples:
        assert list(sample.files) == ["rgba.png", "depth.npy", "face_index.npy", "camera.json"]
        about = json.loads(sample.files["camera.json"])
        matrix = torch.tensor(about["normalization"])
        corners = mesh.vertices @ matrix[:3, :3].T + matrix[:3, 3]
        torch.testing.assert_close(corners, mesh.normalize().vertices, atol=1e-5, rtol=0)
        K, R, t = (torch.tensor(about[name]) for name in ("K", "R", "t"))
        assert (about["height"], about["width"]) == SIZE and about["faces"] == 12
        camera = nr.Camera.projection(K, R, t, orig_size=SIZE)
        drawn = nr.render((corners, mesh.faces), camera, SIZE, outputs=("depth", "face_index"), anti_aliasing=False)
        depth, face = (np.load(io.BytesIO(sample.files[name])) for name in ("depth.npy", "face_index.npy"))
        same = face == drawn.face_index[0].numpy()
        assert (~same).sum() <= 2  # the camera is rounded: pixels on an edge
        inside = same & (face >= 0)
        assert inside.sum() > 100 and np.allclose(depth[inside], drawn.depth[0].numpy()[inside], atol=1e-4)
        assert not depth[face < 0].any()
        picture = np.asarray(Image.open(io.BytesIO(sample.files["rgba.png"])))
        assert picture.shape == (*SIZE, 4) and (picture[face < 0][:, 3] < 255).all()
        assert (picture[..., 3][inside] > 0).all() and (picture[..., 3] == 255).sum() > inside.sum() / 2


def test_the_same_bytes(model: ModelFile) -> None:
    sphere = RenderModel(replace(SETTINGS, cameras=CameraPlan("sphere", 4, (-90.0, 90.0))))
    first = sphere(model).samples
    assert sphere(model).samples == first
    other = sphere(replace(model, name="another")).samples
    assert [one.files for one in other] != [one.files for one in first]
    radius = 1.7
    plan = CameraPlan("sphere", 2000, (-30.0, 60.0))
    words = plan.make("x", radius, (8, 8))[1]
    height = torch.tensor([float(text.split()[-1]) for text in words])
    assert -30 <= height.min() < -28 and 58 < height.max() <= 60
    # Uniform on the sphere: the mean of the sines is that of their bounds, here 0.183, within 5 of its deviations.
    assert abs(torch.deg2rad(height).sin().mean().item() - 0.183) < 5 * 0.394 / 2000**0.5


def test_samples_of_models_and_formats(model: ModelFile, tmp_path: Path) -> None:
    pytest.importorskip("OpenEXR")
    outputs = ("rgba.webp", "rgb.jpg", "alpha.png", "depth.png", "depth.exr", "normal.png", "rgba.exr", "position.npy")
    settings = replace(SETTINGS, outputs=outputs, sample="model", shading="smooth", light="sun")
    views = RenderModel(settings)(model)
    [sample] = views.samples
    assert views.views == 3 and len(sample.files) == 3 * len(outputs) + 1 and sample.key == model.name
    assert len(json.loads(sample.files["cameras.json"])["cameras"]) == 3
    exact = RenderModel(replace(settings, outputs=("rgba.png",)))(model).samples[0].files["001.rgba.png"]
    pixels = [np.asarray(Image.open(io.BytesIO(data))) for data in (exact, sample.files["001.rgba.webp"])]
    assert np.array_equal(*pixels)
    depth = np.asarray(Image.open(io.BytesIO(sample.files["002.depth.png"])))
    assert depth.dtype == np.uint16 and 1000 < depth[depth > 0].min() < depth.max() < 20_000


def test_cameras_of_a_file_and_a_mesh_behind_them(model: ModelFile, tmp_path: Path) -> None:
    eye = {
        "K": [[50, 0, 28], [0, 50, 20], [0, 0, 1]],
        "R": np.diag([1.0, -1.0, -1.0]).tolist(),
        "width": 56,
        "height": 40,
    }
    (tmp_path / "c.json").write_text(json.dumps({"cameras": [eye | {"t": [0, 0, 5]}, eye | {"t": [0, 0, -5]}]}))
    views = RenderModel(replace(SETTINGS, cameras=CameraPlan(str(tmp_path / "c.json"))))(model)
    seen, behind = (np.load(io.BytesIO(sample.files["face_index.npy"])) for sample in views.samples)
    assert (seen >= 0).any() and not (behind >= 0).any()


def test_a_model_that_cannot_be_read(tmp_path: Path) -> None:
    (tmp_path / "bad.obj").write_text("v 1 2\nf 1 2 3\n")
    (tmp_path / "plain.obj").write_text("mtllib lost.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(ValueError, match="bad") as caught:
        RenderModel(SETTINGS)(ModelFile("folder/bad", str(tmp_path / "bad.obj")))
    assert str(tmp_path) not in str(caught.value)
    notes = RenderModel(SETTINGS)(ModelFile("folder/plain", str(tmp_path / "plain.obj"))).notes
    assert len(notes) == 1 and "lost.mtl" in notes[0] and str(tmp_path) not in notes[0]
    with zipfile.ZipFile(tmp_path / "pack.zip", "w") as pack:
        pack.writestr("in/m.obj", "mtllib m.mtl\nusemtl a\n" + (tmp_path / "plain.obj").read_text().partition("\n")[2])
        pack.writestr("in/m.mtl", "newmtl a\nmap_Kd x/broken.png\n")
        pack.writestr("in/x/broken.png", "no picture")
    model = ModelFile("pack", str(tmp_path / "pack.zip"), "in/m.obj")
    told = []
    try:
        told += RenderModel(SETTINGS)(model).notes
    except ValueError as error:
        told.append(str(error))
    assert [sentence.partition(":")[0] for sentence in told] == ["x/broken.png"]


def test_outputs_are_checked() -> None:
    check_outputs(("rgba.png", "depth.exr"))
    for wrong in ((), ("rgba.png",) * 2, ("rgba",), ("rgba.gif",), ("position.png",), ("nonsense.npy",)):
        with pytest.raises(ValueError, match="outputs: expected"):
            check_outputs(wrong)
