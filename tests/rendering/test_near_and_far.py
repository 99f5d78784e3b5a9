"""The depths that `render` draws: by default all of them; planes that are given cut, and say what they cut."""

from __future__ import annotations

import warnings
from typing import Any

import pytest
import torch

import neural_renderer as nr
from neural_renderer.raster import depth_limits


@pytest.fixture(autouse=True)
def nothing_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """No line has been told of a cut yet."""
    monkeypatch.setattr(depth_limits, "_warned", set())


def scene(scale: float, device: Any) -> tuple[tuple[torch.Tensor, torch.Tensor], nr.Camera]:
    vertices, faces = nr.icosphere(2)
    mesh = (vertices * scale).to(device), faces.to(device)
    eye = torch.tensor([[0.5, 0.6, -2.7], [2.0, -0.5, -1.9]], device=device) * scale
    return mesh, nr.Camera.look_at(eye)


@pytest.mark.usefixtures("deterministic")  # for vertex normals, sums of those of faces
@pytest.mark.parametrize("scale", [2.0**-14, 2.0**-7, 2.0**7, 2.0**20])
def test_every_scale_gives_the_same_picture(device, scale):
    images = nr.render(*scene(1.0, device), 48, shading="smooth")
    scaled = nr.render(*scene(scale, device), 48, shading="smooth")
    assert images.alpha.max() == 1 and torch.equal(images.alpha, scaled.alpha)
    torch.testing.assert_close(images.rgb, scaled.rgb, rtol=1e-5, atol=1e-5)
    shown = images.alpha == 1
    torch.testing.assert_close(images.depth[shown] * scale, scaled.depth[shown], rtol=1e-5, atol=0)


@pytest.mark.usefixtures("deterministic")
@pytest.mark.parametrize("gradient", ["edge", "nmr", "opendr"])
@pytest.mark.parametrize("anti_aliasing", [False, True])
def test_nothing_changes_between_the_old_planes(device, gradient, anti_aliasing):
    """Images and gradients are equal to the bit."""
    options: dict[str, Any] = {"gradient": gradient, "anti_aliasing": anti_aliasing}
    found = []
    for planes in ({}, {"near": 0.1, "far": 100.0}):
        (vertices, faces), camera = scene(1.0, device)
        vertices.requires_grad_()
        images = nr.render((vertices, faces), camera, 40, **options, **planes)
        weights = torch.rand(images.depth.shape, generator=torch.Generator().manual_seed(0)).to(device)
        loss = (images.depth * weights).sum() + (images.rgb * weights[:, None]).sum()
        found.append((*images, *torch.autograd.grad(loss, vertices)))
    for free, given in zip(*found, strict=True):
        assert torch.equal(free, given)


def test_depth_of_the_background(device):
    for scale, expected in ((1.0, 100.0), (20.0, 100.0), (100.0, None)):
        mesh, camera = scene(scale, device)
        images = nr.render(mesh, camera, 32, anti_aliasing=False)
        farthest = camera(mesh[0])[..., 2].amax(1)
        for depth, alpha, far in zip(images.depth, images.alpha, farthest, strict=True):
            behind = depth[alpha == 0]
            assert len(behind) and (behind == behind[0]).all() and depth[alpha == 1].max() <= far < behind[0]
            assert behind[0] == expected if expected else torch.isclose(behind[0], 1.05 * far)
        fragments = nr.fragments(mesh, camera, 32, anti_aliasing=False)
        assert torch.equal(fragments.depth, images.depth)
    given = nr.render(*scene(1.0, device), 32, far=7.0, anti_aliasing=False)
    assert (given.depth[given.alpha == 0] == 7).all()


def test_the_background_of_an_image_does_not_depend_on_the_others(device):
    mesh, camera = scene(100.0, device)
    both = nr.render(mesh, camera, 32).depth
    for number, one in enumerate(camera):
        assert torch.equal(nr.render(mesh, one, 32).depth[0], both[number])
    strips = nr.render(mesh, camera, 64, tile=16).depth
    assert torch.equal(strips, nr.render(mesh, camera, 64).depth)
    nothing = nr.render((mesh[0], mesh[1][:0]), camera, 8)
    assert (nothing.depth == 100).all()


def test_what_is_in_front_of_an_eye_inside_is_drawn(device):
    """A face in the distance 0.01, which the old near plane hid, and one that goes through the camera's plane."""
    vertices = torch.tensor([[-1.0, -1, 0.01], [1, -1, 0.01], [0, 1, 0.01], [-9, -1, 3], [9, -1, 3], [0, 2, -3]])
    vertices.requires_grad_()
    faces = torch.tensor([[0, 1, 2], [3, 4, 5]])
    camera = nr.Camera.look((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    images = nr.render((vertices.to(device), faces.to(device)), camera, 32)
    assert images.alpha[0, 16, 16] == 1 and images.depth[0, 16, 16].item() == pytest.approx(0.01)
    (gradient,) = torch.autograd.grad(sum(image.sum() for image in images), vertices)
    assert bool(gradient.isfinite().all())


@pytest.mark.parametrize(
    ("scale", "planes", "sentence"),
    [
        (
            100.0,
            {"near": 0.1, "far": 100.0},
            r"at depths 1\d\d(\.\d)? … 3\d\d(\.\d)?, and near 0\.1, far 100 cut all of it away",
        ),
        (0.01, {"near": 0.1}, r"at depths 0\.0\d+ … 0\.0\d+, and near 0\.1 cut all of it away"),
        (1.0, {"far": 2.5}, r"at depths 1\.\d+ … 3\.\d+, and far 2\.5 cut \d+ % of its corners away"),
    ],
)
def test_planes_say_what_they_cut(device, scale, planes, sentence):
    mesh, camera = scene(scale, device)
    for draw in (nr.render, nr.fragments):
        depth_limits._warned.clear()
        with pytest.warns(UserWarning, match=rf"near, far: the mesh is {sentence}") as told:
            for _ in range(3):
                draw(mesh, camera, 16, **planes)
        assert len([one for one in told if "near, far" in str(one.message)]) == 1  # once for this line
        assert told[0].filename == __file__


def test_a_mesh_behind_all_cameras_is_told(device):
    mesh, _ = scene(1.0, device)
    away = nr.Camera.look((0.0, 0.0, -3.0), (0.0, 0.0, -1.0)).to(device)
    with pytest.warns(
        UserWarning, match=r"camera: the whole mesh is behind it, at depths -\d\.?\d* … -\d\.?\d*; the images"
    ):
        images = nr.render(mesh, away, 16)
    assert not images.alpha.any()


@pytest.mark.parametrize("scale", [1e-12, 1e-8, 1e12, 1e20])
@pytest.mark.parametrize("has_planes", [False, True])
def test_units_that_cannot_be_drawn_are_told(device, scale, has_planes):
    """A picture without the mesh came silently."""
    mesh, camera = scene(scale, device)
    planes = {"near": 0.1 * scale, "far": 100 * scale} if has_planes else {}
    depth_limits._warned.clear()
    sentence = r"camera: the mesh is at depths .* only depths of 1e-06 to 1e\+12 are drawn; choose another unit"
    with pytest.warns(UserWarning, match=sentence):
        nr.render(mesh, camera, 16, **planes)


def test_a_far_plane_beyond_what_is_drawn_is_told(device):
    """Also by functions of the first packages, which give it."""
    corners = torch.tensor([[[[-1.0, -1.0, 1e20], [1.0, -1.0, 1e20], [1.0, 1.0, 1e20]]]], device=device)
    with pytest.warns(UserWarning, match=r"^faces: depths reach 1e\+20, but faces with a corner beyond 1e\+12 are not"):
        assert not nr.rasterize_silhouettes(corners, 8, far=1e30).any()


def test_silence(device):
    """Where nothing is cut, where one of several cameras sees the mesh, and where values are not checked."""
    mesh, camera = scene(1.0, device)
    one_away = nr.Camera.look(((0.0, 0.0, -3.0), (0.0, 0.0, -3.0)), ((0.0, 0.0, -1.0), (0.0, 0.0, 1.0))).to(device)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        nr.render(mesh, camera, 16, near=0.1, far=100.0)
        nr.render(mesh, one_away, 16)
        nr.rasterize_images(torch.rand(1, 1, 3, 3, device=device) + 200, 16, outputs=("alpha",))
        nr.check_values(False)
        try:
            nr.render(mesh, camera, 16, near=0.1, far=0.2)
        finally:
            nr.check_values(True)


def test_the_old_renderer_keeps_its_planes(device):
    mesh, _ = scene(300.0, device)
    renderer = nr.Renderer(image_size=16, camera_mode="look_at")
    renderer.eye = [0.0, 0.0, -900.0]
    assert not renderer.render_silhouettes(mesh[0][None], mesh[1][None]).any()
    assert (renderer.render_depth(mesh[0][None], mesh[1][None]) == 100).all()


def test_wrong_planes():
    for planes, sentence in (({"near": 2.0, "far": 1.0}, "near 2.0, far 1.0"), ({"near": -1.0}, "near -1.0")):
        with pytest.raises(ValueError, match=f"near, far: expected 0 <= near < far <= 1e\\+30, got {sentence}"):
            nr.render(*scene(1.0, "cpu"), 16, **planes)
    with pytest.raises(TypeError, match="far: expected a number, got str"):
        nr.render(*scene(1.0, "cpu"), 16, far="inf")


@pytest.mark.parametrize("far", [1e7, 1e12])
def test_a_scene_far_from_the_origin(far):
    """It is drawn in float64; float32 merges its points, which is an error."""
    vertices, faces = nr.icosphere(2)
    eye, forward = torch.tensor([[0.0, 0.0, -3.0]]).double(), torch.tensor([[0.0, 0.0, 1.0]]).double()
    aside = torch.tensor([far, 0.0, 0.0]).double()
    expected = nr.render((vertices, faces), nr.Camera.look(eye.float(), forward.float()), 32, outputs=("alpha",)).alpha
    moved = vertices.double() + aside
    for camera in (nr.Camera.look(eye + aside, forward), nr.Camera.look_at(eye + aside, at=aside)):
        image = nr.render((moved, faces), camera, 32, outputs=("alpha",)).alpha
        assert (image - expected).abs().mean() < 1e-3  # steps of 1e12 are 1.2e-4, a thousandth of a pixel
        for mesh in (lambda: (moved.float(), faces), lambda: nr.Mesh(moved, faces)):
            with pytest.raises(ValueError, match=r"^vertices: expected points that float32 tells apart, got"):
                nr.render(mesh(), camera, 32)
