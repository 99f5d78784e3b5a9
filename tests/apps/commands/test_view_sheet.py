"""`render --sheet`: five views at one scale with the sizes of the mesh."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps import command_line as cli
from neural_renderer.apps.render.view_sheet import load_for_sheet, view_sheet

SIZE = 64


def test_views_are_where_they_are_said_to_be() -> None:
    """A box of 4 x 2 x 1 whose sides have colours of their own."""
    vertices, faces = nr.cube()
    normals = torch.linalg.cross(*(vertices[faces[:, [1, 2]].long()] - vertices[faces[:, :1].long()]).unbind(1))
    side = torch.nn.functional.normalize(normals, dim=1)
    colors = torch.where(side < -0.5, 0.4, side.clamp(min=0))  # +x red, +y green, +z blue; −z a dark blue
    scaled = vertices * torch.tensor([2.0, 1.0, 0.5]) + 100
    box = nr.Mesh(scaled, faces, face_colors=colors)
    lines = ["name  box", "another  line"]
    pixels = view_sheet(box, SIZE, lines, light=None, shading="flat", background=1.0)
    assert pixels.dtype == torch.uint8 and pixels.shape[1] == 5 * SIZE and pixels.shape[0] > SIZE + 3 * 12
    views = pixels[:SIZE].split(SIZE, 1)
    seen = [view[SIZE // 2, SIZE // 2].tolist() for view in views]
    assert seen[:4] == [[0, 0, 255], [255, 0, 0], [0, 255, 0], [0, 0, 102]]
    blue, red, green = ((view == torch.tensor(color)).all(2) for view, color in zip(views[:3], seen[:3], strict=True))
    # The longest side takes 1.3 of the picture's 2 units, all at one scale.
    wide = 1.3 / 4 * SIZE / 2
    for shown, width, height in ((blue, 4, 2), (red, 1, 2), (green, 4, 1)):
        assert shown.any(0).sum().item() == pytest.approx(width * wide, abs=2)
        assert shown.any(1).sum().item() == pytest.approx(height * wide, abs=2)
    assert len(views[4][10:].reshape(-1, 3).unique(dim=0)) > 3  # three sides and the background


def test_the_command_draws_a_sheet(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mesh = tmp_path / "ball.obj"
    nr.Mesh.icosphere(1).save(mesh)
    sheet = tmp_path / "sheet.png"
    line = ["render", str(mesh), "-o", str(sheet), "--sheet", "--size", "48"]
    assert cli.main(line) == 0
    assert nr.load_image(sheet).shape[1] == 5 * 48
    capsys.readouterr()
    for more, sentence in (
        (["--turntable", "3"], "--sheet: expected it without --turntable"),
        (["--mode", "depth"], "--sheet: expected --mode rgb"),
        (["--save", "alpha", str(sheet)], "--sheet: expected it without --save"),
    ):
        assert cli.main([*line, *more]) == 1
        assert sentence in capsys.readouterr().err
    flat = tmp_path / "flat.obj"
    flat.write_text("v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n")
    assert cli.main(["render", str(flat), "-o", str(sheet), "--sheet"]) == 1
    assert "expected vertices that differ" in capsys.readouterr().err


def test_large_images_are_averaged_before_the_sheet(tmp_path: Path) -> None:
    vertices = torch.tensor([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    faces = torch.tensor([[0, 1, 2], [0, 2, 3]])
    picture = torch.rand(64, 64, 3).repeat_interleave(16, 0).repeat_interleave(16, 1)
    path = tmp_path / "square.glb"
    mesh = nr.UVMesh(vertices, faces, 0.5 + 0.5 * vertices[faces.long()][..., :2], picture, wrap="clamp")
    mesh.save(path)
    small, whole = load_for_sheet(path, SIZE, False), nr.UVMesh.load(path)
    assert small.images[0].shape[:2] == (128, 128)
    assert load_for_sheet(path, 16 * SIZE, False).images[0].shape == whole.images[0].shape
    sheets = [view_sheet(each, SIZE, [], light=None, shading="flat", background=1.0).float() for each in (small, whole)]
    assert (sheets[0] - sheets[1]).abs().mean() < 0.5
