"""Open surfaces of photographs: depth by sweeping, one mesh of all views, and the command."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps import command_line as cli
from neural_renderer.apps.fit import Views
from neural_renderer.apps.fit.doubts import doubt_colors, doubts
from neural_renderer.apps.fit.photos.geometry import surface
from neural_renderer.apps.fit.photos.geometry.surface import find_surface
from neural_renderer.apps.fit.photos.geometry.sweep import sweep

SIZE = 96


def wall() -> tuple[Views, nr.UVMesh]:
    """Draw a wall with a pattern and a bump, without a back, from five places."""
    u, v = torch.meshgrid(torch.linspace(0, 1, 41), torch.linspace(0, 1, 41), indexing="ij")
    x, y = 4 * u.flatten() - 2, 4 * v.flatten() - 2
    vertices = torch.stack((x, y, -0.4 * torch.exp(-2 * (x**2 + y**2))), 1)
    corner = (torch.arange(40)[:, None] * 41 + torch.arange(40)).flatten()
    faces = torch.stack((corner, corner + 41, corner + 1, corner + 1, corner + 41, corner + 42), 1).view(-1, 3)
    pattern = torch.rand(100, 100, 3, generator=torch.Generator().manual_seed(0))
    mesh = nr.UVMesh(vertices, faces, torch.stack((u.flatten(), v.flatten()), 1), pattern)
    eyes = torch.tensor([[0.0, 0.0, -4.0], [0.7, 0.0, -4.0], [-0.7, 0.0, -4.0], [0.0, 0.7, -4.0], [0.0, -0.7, -4.0]])
    return Views.of(mesh, nr.Camera.look_at(eyes, viewing_angle=20), SIZE), mesh


def true_depth(views: Views, mesh: nr.UVMesh) -> torch.Tensor:
    """Draw the depth of the first view."""
    return nr.render(mesh, views.camera[:1], SIZE, outputs=("depth",), anti_aliasing=False).depth[0]


def test_sweep_finds_depth_between_its_hypotheses() -> None:
    views, mesh = wall()
    assert views.photos is not None
    true = true_depth(views, mesh)
    depth, score = sweep(
        views, views.photos.mean(1), 0, [1, 2, 3, 4], torch.full((SIZE, SIZE), 4.0), torch.linspace(0.85, 1.05, 41)
    )
    inner = (slice(8, -8), slice(8, -8))
    assert float(((depth - true).abs() / true)[inner].median()) < 0.0025, "half a step"
    assert float(score[inner].median()) > 0.8


def test_depths_that_disagree_ask_for_a_larger_size(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(surface, "supported", lambda maps: torch.zeros_like(maps.depth, dtype=torch.bool))
    views, _ = wall()
    flat = torch.ones(len(views), SIZE, SIZE)
    with pytest.raises(ValueError, match=f"or need a size=PIXELS above {SIZE}"):
        surface._cloud(views, surface.DepthMaps(*[flat] * len(fields(surface.DepthMaps))))


@pytest.mark.slow
def test_surface_of_a_wall_is_open_and_where_the_wall_is() -> None:
    pytest.importorskip("pycolmap")
    views, mesh = wall()
    vertices, faces = find_surface(views, mesh.vertices[::7], lambda *_: None)
    drawn = nr.render((vertices, faces), views.camera[:1], SIZE, outputs=("depth", "alpha"), anti_aliasing=False)
    seen = drawn.alpha[0] > 0.5
    assert float(seen[8:-8, 8:-8].float().mean()) > 0.95
    error = (drawn.depth[0] - true_depth(views, mesh)).abs()[seen]
    pixel = 2 * 4.0 * 0.364 / SIZE
    assert float(error.median()) < pixel
    edges = torch.cat((faces[:, :2], faces[:, 1:], faces[:, ::2])).sort(1).values
    assert int((torch.unique(edges, dim=0, return_counts=True)[1] == 1).sum()) > 0, "no back was made"


def test_views_that_lack_something_are_doubted() -> None:
    eyes = nr.get_points_from_angles(3.0, 20.0, torch.arange(8) * 45.0)
    sphere = nr.Mesh.icosphere(2, 0.5)
    around = Views.of(sphere, nr.Camera.look_at(eyes, viewing_angle=25), 48)
    assert doubts(around) == {}
    side = Views.of(sphere, nr.Camera.look_at(eyes[:3] * torch.tensor([0.3, 1.0, 1.0]), viewing_angle=25), 48)
    assert "on one side" in doubts(Views(side.camera[[0, 1, 1]], side.masks[[0, 1, 1]]))["one side"]
    two = nr.Mesh(
        torch.cat((sphere.vertices + 0.6, sphere.vertices - 0.6)),
        torch.cat((sphere.faces, sphere.faces + len(sphere.vertices))),
    )
    assert "two objects" in doubts(Views.of(two, nr.Camera.look_at(eyes, viewing_angle=35), 64))["two objects"]
    cut = around.masks.clone()
    cut[:3] = torch.cat((torch.zeros(3, 24, 48), cut[:3, :24]), 1)  # the lower half leaves the image
    assert "3 of 8 images cut the object off" in doubts(Views(around.camera, cut))["cut off"]
    holed = around.masks.clone()
    holed[::2, 18:30, 18:30] = 0
    assert "colours of the object" in doubts(Views(around.camera, holed))["masks"]


def test_colors_that_change_from_view_to_view_are_doubted() -> None:
    views, mesh = wall()
    assert views.photos is not None
    noise = torch.rand(views.photos.shape, generator=torch.Generator().manual_seed(1))
    plain = torch.full((len(mesh.faces), 2, 2, 2, 3), 0.5)
    assert "shine" in str(doubt_colors(replace(views, photos=noise), (mesh.vertices, mesh.faces, plain)))
    same = replace(views, photos=views.draw((mesh.vertices, mesh.faces, plain), "rgb").rgb)
    assert doubt_colors(same, (mesh.vertices, mesh.faces, plain)) is None


def test_masks_larger_than_the_shape_are_no_doubt_about_its_colors() -> None:
    ball = nr.Mesh.icosphere(2)
    plain = torch.full((len(ball.faces), 2, 2, 2, 3), 0.5)
    camera = nr.Camera.look_at(nr.get_points_from_angles(4.0, 20.0, torch.arange(4) * 90.0), viewing_angle=25)
    room = torch.rand(4, 3, 32, 32, generator=torch.Generator().manual_seed(2))
    drawn = Views.of(ball, camera, 32).draw((ball.vertices, ball.faces, plain), ("rgb", "alpha"))
    scenes = drawn.rgb + (1 - drawn.alpha[:, None]) * room
    masks = (torch.nn.functional.max_pool2d(drawn.alpha, 9, 1, 4) > 0).float()
    views = Views(camera, masks, scenes, scenes=scenes)
    assert doubt_colors(views, (ball.vertices, ball.faces, plain)) is not None
    assert doubt_colors(replace(views, backgrounds=room), (ball.vertices, ball.faces, plain)) is None


def test_surface_is_made_of_photographs_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    nr.save_image(tmp_path / "a.png", torch.zeros(3, 16, 16))
    for options, said in (("--no-photos", "photographs alone"), ("--light=none", "no steps for details")):
        assert cli.main(["fit", str(tmp_path), "-o", str(tmp_path / "out"), "--surface", options]) != 0
        assert f"--surface: expected {said}" in capsys.readouterr().err
