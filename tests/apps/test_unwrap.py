"""Charts and baked images of meshes with texture cubes."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest
import torch
from torch import Tensor

import neural_renderer as nr
from neural_renderer.apps import command_line as cli
from neural_renderer.apps.common.geometry.unwrap import chart_coordinates
from neural_renderer.camera.files.opencv import save_cameras

needs_xatlas = pytest.mark.skipif(importlib.util.find_spec("xatlas") is None, reason="xatlas is not installed")


def cells(count: int) -> Tensor:
    """Give each face a triangle of its own, with gaps."""
    side = 4
    origin = torch.cartesian_prod(torch.arange(side), torch.arange(side))[:count, None] / side
    return origin + torch.tensor([[0.02, 0.02], [0.23, 0.02], [0.23, 0.23]])


def colored(level: int = 2) -> nr.Mesh:
    vertices, faces = nr.icosphere(level)
    return nr.Mesh(vertices, faces, vertex_colors=vertices * 0.4 + 0.5)


def test_baked_colours_are_those_of_the_cubes() -> None:
    colors = torch.rand(12, 3, generator=torch.Generator().manual_seed(0))
    mesh, uv = nr.Mesh(*nr.cube(), face_colors=colors), cells(12)
    image = nr.unwrap(mesh, 64, uv=uv).images[0]
    # Inside each face, and in the gap beside it, where nothing else is nearer.
    places = (uv.mean(1) * 64).long()
    torch.testing.assert_close(image[63 - places[:, 1], places[:, 0]], colors, atol=1e-6, rtol=0)
    assert torch.isfinite(image).all()


def test_picture_is_the_same() -> None:
    vertices, faces = nr.cube()
    mesh = nr.Mesh(vertices, faces, vertex_colors=vertices.clamp(-0.5, 0.5) + 0.5)
    camera = nr.Camera.look_at((1.5, 2.0, -3.0), viewing_angle=25)
    before = nr.render(mesh, camera, 64, light=None).rgb
    after = nr.render(nr.unwrap(mesh, 256, uv=cells(12)), camera, 64, light=None).rgb
    # Mipmaps mix texels, the more the flatter a face is seen, and at its edges those of other faces. On average over
    # the image that is far below the change of colour from texel to texel, 1/54.
    assert (after - before).abs().mean() < 1 / 54 / 5


def test_gradients_do_not_flow_and_the_mesh_stays() -> None:
    mesh = nr.Mesh(*nr.cube(), face_colors=torch.rand(12, 3))
    before = mesh.textures.detach().clone()
    unwrapped = nr.unwrap(mesh, 16, uv=cells(12))
    assert not unwrapped.vertices.requires_grad and not unwrapped.images[0].requires_grad
    assert torch.equal(mesh.textures.detach(), before) and torch.equal(unwrapped.faces, mesh.faces)


def test_bad_arguments() -> None:
    mesh = nr.Mesh(*nr.cube())
    for arguments, error, sentence in (
        ({"size": 8}, ValueError, "size: expected"),
        ({"size": 10000}, ValueError, "size: expected at most 8192, got 10000"),
        ({"gutter": 0}, ValueError, "gutter: expected"),
        ({"uv": torch.zeros(3, 3, 2)}, ValueError, "uv: expected"),
        ({"uv": torch.full((12, 3, 2), 1.5)}, ValueError, r"uv: expected coordinates in \[0, 1\], got values outside"),
    ):
        with pytest.raises(error, match=sentence):
            nr.unwrap(mesh, **arguments)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="mesh: expected a Mesh, got tuple"):
        nr.unwrap(nr.cube())  # type: ignore[arg-type]


def test_a_missing_library_is_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "xatlas", None)
    sentence = 'expected xatlas to be installed to make charts (pip install "neural-renderer[fit]")'
    with pytest.raises(ModuleNotFoundError) as caught:
        nr.unwrap(nr.Mesh(*nr.cube()))
    assert str(caught.value) == sentence
    # The command says so before it begins.
    assert cli.main(["fit", str(tmp_path), "-o", str(tmp_path / "out"), "--unwrap", "64"]) == 1
    assert capsys.readouterr().err == sentence + "\n"


@needs_xatlas
def test_sizes_out_of_range(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["fit", str(tmp_path), "-o", str(tmp_path / "out"), "--unwrap", "9"]) == 1
    assert "--unwrap: expected at least 16" in capsys.readouterr().err


@needs_xatlas
def test_charts_do_not_overlap_and_keep_their_distance() -> None:
    vertices, faces = nr.icosphere(3)
    uv = chart_coordinates(vertices * torch.tensor([1.0, 0.4, 0.7]), faces, 256, 4)
    assert uv.shape == (len(faces), 3, 2) and float(uv.min()) >= 0 and float(uv.max()) <= 1
    corners = torch.nn.functional.pad(2 * uv - 1, (0, 1), value=1.0)
    options = {"anti_aliasing": False, "two_sided": True, "perspective": False, "near": 0.5, "far": 2.0}
    alpha = nr.rasterize_images(corners[None], 1024, outputs=("alpha",), **options).alpha  # type: ignore[arg-type]
    sides = uv.roll(-1, 1) - uv
    area = (sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]).abs().sum() / 2
    # Overlaps would hide a part of the area. The error of counting pixels is below one along each chart's border.
    assert abs(float(alpha.mean()) - float(area)) < 0.01 and float(area) > 0.3


@needs_xatlas
@pytest.mark.parametrize("suffix", ["obj", "glb"])
def test_unwrapped_files_show_the_same(suffix: str, tmp_path: Path) -> None:
    mesh = colored()
    unwrapped = nr.unwrap(mesh, 256)
    unwrapped.save(tmp_path / f"ball.{suffix}")
    read = nr.UVMesh.load(tmp_path / f"ball.{suffix}")
    assert len(read.images) == 1 and read.images[0].shape == (256, 256, 3)
    camera = nr.Camera.look_at(nr.get_points_from_angles(2.7, 20.0, torch.arange(4) * 90.0), viewing_angle=25)
    before = nr.render(mesh, camera, 96, light=None).rgb
    after = nr.render(read, camera, 96, light=None).rgb
    # Eight bits; texels of a hundredth of the radius, over which a colour changes by 0.004; and mipmaps at the outline.
    assert (after - before).abs().mean() < 0.002 and (after - before).abs().max() < 0.1


@needs_xatlas
def test_fit_writes_one_image_of_the_chosen_size(tmp_path: Path) -> None:
    eyes = nr.get_points_from_angles(3.0, 20.0, torch.arange(6) * 60.0)
    camera = nr.Camera.look_at(eyes, viewing_angle=25)
    views = nr.render(colored(), camera, 48, light=None)
    names = [f"{row}.png" for row in range(6)]
    save_cameras(tmp_path / "cameras.json", camera, names, (48, 48))
    for row, name in enumerate(names):
        nr.save_image(tmp_path / name, torch.cat((views.rgb[row], views.alpha[row][None])).detach())
    small = ["--cells=16", "--steps=2", "--detail-steps=0", "--texture-steps=2", "--turntable=0", "--unwrap=200"]
    assert cli.main(["fit", str(tmp_path), "-o", str(tmp_path / "out"), *small]) == 0
    for name in ("mesh.obj", "mesh.glb"):
        images = nr.UVMesh.load(tmp_path / "out" / name).images
        assert [tuple(image.shape) for image in images] == [(200, 200, 3)]
