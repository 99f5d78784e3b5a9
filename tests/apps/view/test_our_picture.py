"""Our own renderer's picture from a browser's view, and gradients on it."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

import neural_renderer as nr
from neural_renderer.apps.view.drawing.our_picture import (
    FREE_LOSSES,
    IMAGE_LOSSES,
    Target,
    View,
    arrows,
    draw,
    heat,
    loss_gradient,
    picture,
)
from neural_renderer.apps.view.drawing.snapshot import take_snapshot
from neural_renderer.apps.view.frusta import photographs, quaternion


def view_from(eye: tuple[float, float, float], angle: float = 25.0) -> tuple[View, nr.Camera]:
    """A view as a browser reports it, and the camera that it means."""
    camera = nr.Camera.look_at(eye, viewing_angle=angle)
    right, up, forward = camera.rotation[0].double().numpy()
    axes = np.stack((right, -up, forward), 1)
    return View(quaternion(axes), np.array(eye), math.radians(2 * angle), 4 / 3), camera


@pytest.mark.parametrize("eye", [(0.0, 0.4, -3.0), (2.0, -1.0, 1.5), (-0.3, 3.0, 0.2)])
def test_the_picture_is_that_of_the_camera(eye: tuple[float, float, float]) -> None:
    view, camera = view_from(eye)
    place = np.array([0.3, -0.2, 0.1])
    mesh = nr.Mesh.icosphere(2)
    expected = nr.render(
        (mesh.vertices + torch.tensor(place).float(), mesh.faces), camera, (48, 64), outputs="alpha"
    ).alpha[0]
    found = picture([(take_snapshot(mesh), place)], view, 48, output="alpha")[..., 0] / 255
    assert found.shape == (48, 64)
    # Rotations in float32 move outlines by some 1e-6 of a pixel: some of the four samples of a few pixels may differ.
    different = np.abs(found - expected.detach().numpy()) > 1 / 255
    assert different.mean() < 0.005


def test_the_nearer_mesh_hides_the_other() -> None:
    view, _ = view_from((0.0, 0.0, -4.0))
    vertices, faces = nr.icosphere(2, radius=0.5)
    red, blue = (
        take_snapshot(nr.Mesh(vertices, faces, face_colors=torch.tensor(color).expand(len(faces), 3)))
        for color in ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    )
    near, far = np.array([0.0, 0.0, -1.0]), np.zeros(3)
    for meshes in ([(red, near), (blue, far)], [(blue, far), (red, near)]):
        assert picture(meshes, view, 32, lit=False)[16, 21].tolist() == [255, 0, 0]
    depth = picture([(red, near), (blue, far)], view, 32, output="depth")
    assert depth[16, 21, 0] > 200 and depth[0, 0, 0] == 0


def test_depth_has_shades() -> None:
    """Outlines, where depth is a mean with the far plane, have the depth of the mesh."""
    view, camera = view_from((0.0, 0.0, -3.0))
    mesh = nr.Mesh.icosphere(3, radius=0.5)
    grey = picture([(take_snapshot(mesh), np.zeros(3))], view, 48, output="depth")[..., 0].astype(float)
    images = nr.render((mesh.vertices, mesh.faces), camera, (48, 64), outputs=("alpha", "depth"), anti_aliasing=False)
    inside = images.alpha[0] == 1
    depth = images.depth[0][inside].detach().double().numpy()
    shades = grey[inside.numpy()]
    low, high = depth.min(), np.quantile(depth, 0.98)
    # An outline's samples differ in depth by less than a tenth of the sphere's; a shade is 1/255.
    assert np.abs(shades / 255 - (1 - 0.75 * ((depth - low) / (high - low)).clip(0, 1))).mean() < 0.05
    assert shades.max() > 240 and np.quantile(shades, 0.05) < 110


@pytest.mark.parametrize("estimator", ["nmr", "edge"])
@pytest.mark.parametrize("loss", [*FREE_LOSSES, *IMAGE_LOSSES])
def test_gradients_are_those_of_the_loss(loss: str, estimator: str) -> None:
    _, camera = view_from((0.0, 0.4, -3.0))
    snapshot = take_snapshot(nr.Mesh.icosphere(2))
    other = draw(take_snapshot(nr.Mesh.icosphere(2, radius=0.7)), camera, (32, 32), lit=False)
    target = Target(other.alpha, other.rgb) if loss in IMAGE_LOSSES else None
    value, gradient = loss_gradient(
        snapshot, camera, (32, 32), loss, target=target, gradient=estimator, lit=loss == "brightness"
    )
    assert math.isfinite(value) and gradient.shape == snapshot.vertices.shape
    assert bool((gradient != 0).any())
    if loss == "silhouette IoU":
        # The mesh is larger than the target, so downhill is inwards.
        assert float((gradient * snapshot.vertices).sum()) > 0
        vertices = snapshot.vertices.clone().requires_grad_()
        images = nr.render((vertices, snapshot.faces), camera, (32, 32), outputs="alpha", gradient=estimator)
        expected = torch.autograd.grad(nr.losses.silhouette_iou_loss(images.alpha, other.alpha), vertices)[0]
        assert torch.allclose(gradient, expected, rtol=1e-4, atol=1e-7)


def test_an_image_loss_needs_a_target() -> None:
    _, camera = view_from((0.0, 0.4, -3.0))
    with pytest.raises(ValueError, match="target: expected one for the loss photometric"):
        loss_gradient(take_snapshot(nr.Mesh.icosphere(1)), camera, (16, 16), "photometric")


def test_arrows_point_downhill() -> None:
    snapshot = take_snapshot(nr.Mesh.icosphere(1))
    gradient = torch.zeros_like(snapshot.vertices)
    gradient[3] = torch.tensor([2.0, 0.0, 0.0])
    gradient[7] = torch.tensor([0.0, 1.0, 0.0])
    gradient[8] = torch.tensor([0.0, 1e-3, 0.0])  # too small to be seen
    points, colors = arrows(snapshot, gradient)
    steps = points[:, 1] - points[:, 0]
    for pair, vertex, step in zip(points, snapshot.vertices[[3, 7]].numpy(), steps, strict=True):
        assert np.allclose(pair[int(vertex @ step < 0)], vertex, atol=1e-6)  # outside of the sphere
    assert len(colors) == 2
    assert steps[0, 0] < 0 and np.allclose(steps[0, 0], np.sqrt(2) * steps[1, 1])
    assert len(arrows(snapshot, torch.zeros_like(gradient))[0]) == 0


def test_heat_grows_redder() -> None:
    colors = heat(torch.linspace(0, 1, 20))
    excess = colors[:, 0] - colors[:, 1]
    assert bool((excess.diff() > -1e-6).all()) and bool((colors >= 0).all()) and bool((colors <= 1).all())


@pytest.mark.parametrize("seed", range(8))
def test_quaternions(seed: int) -> None:
    generator = np.random.default_rng(seed)
    axes, _ = np.linalg.qr(generator.normal(size=(3, 3)))
    axes *= np.linalg.det(axes)  # a rotation
    if seed == 0:
        axes = np.diag([-1.0, -1.0, 1.0])
    view = View(quaternion(axes), np.zeros(3), 1.0, 1.0)
    rotation = view.camera(np.zeros(3)).rotation[0].double().numpy()
    assert np.allclose(rotation, np.stack((axes[:, 0], -axes[:, 1], axes[:, 2])), atol=1e-6)


def test_poses_of_cameras() -> None:
    """A frustum lies where its camera is, and its field of view is the camera's, however the camera was made."""
    eye = (0.5, 1.0, -2.5)
    plain = nr.Camera.look_at(eye, viewing_angle=20)
    mirrored = nr.Camera.look_at(eye, viewing_angle=20, mirrored=True)
    pose = torch.eye(4)
    right, up, forward = plain.rotation[0]
    pose[:3, :3], pose[:3, 3] = torch.stack((right, -up, forward), 1), torch.tensor(eye)
    focal = 24 / math.tan(math.radians(20))
    K = torch.tensor([[focal, 0, 32], [0, focal, 24], [0, 0, 1]])
    with_k = nr.Camera.from_matrix(camera_to_world=pose, K=K, orig_size=(48, 64))
    for camera, is_mirrored in ((plain, False), (mirrored, True), (with_k, False)):
        [one] = photographs(camera, torch.rand(1, 3, 48, 64), None)
        axes, position, flipped = one.pose()
        assert np.allclose(position, eye, atol=1e-5) and flipped == is_mirrored
        assert np.allclose(axes, pose[:3, :3].numpy(), atol=1e-5) and np.isclose(np.linalg.det(axes), 1)
        assert math.isclose(one.field(), math.radians(40), rel_tol=1e-5)


def test_what_is_no_camera_is_refused() -> None:
    camera = nr.Camera.look_at((0.0, 1.0, -2.5))
    with pytest.raises(TypeError, match="camera: expected a Camera, got str"):
        photographs("camera", None, None)
    with pytest.raises(ValueError, match="photos"):
        photographs(camera, torch.rand(2, 3, 8, 8), None)
    with pytest.raises(ValueError, match="masks: expected the size of the photos"):
        photographs(camera, torch.rand(1, 3, 8, 8), torch.rand(1, 8, 9))
