"""The estimator `gradient="opendr"` against the same rules written pixel by pixel in float64, and closed forms."""

from __future__ import annotations

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import neural_renderer as nr
from neural_renderer.raster.ops.coverage import coverage
from neural_renderer.raster.visibility.opendr import opendr_gradient, opendr_gradient_backward
from tests.raster.scenes import FAR, NEAR, Scene, examples, scenes
from tests.rounding import rounding


def reference(grad, image, faces, face_index, perspective):
    """Visit every pixel, both axes and both neighbours."""
    grad, image, faces = (t.detach().double().cpu() for t in (grad, image, faces))
    result = torch.zeros_like(faces)
    batch, height, width = face_index.shape

    def plane(b, f):
        """Return a, b, c of each barycentric weight a x + b y + c, and the nearness likewise; None if not usable."""
        corners = faces[b, f]
        matrix = torch.cat((corners[:, :2], torch.ones(3, 1, dtype=torch.float64)), 1).T  # columns (x, y, 1)
        if torch.linalg.det(matrix) == 0 or (perspective and bool((corners[:, 2] <= 0).any())):
            return None
        weights = torch.linalg.inv(matrix)  # [3, 3]: rows a, b, c of the three weights
        near = 1 / corners[:, 2] if perspective else -corners[:, 2]
        return weights, near @ weights

    def at(b, row, column):
        """Return the face, its nearness at the pixel centre, and its plane."""
        f = int(face_index[b, row, column])
        found = plane(b, f) if f >= 0 else None
        place = torch.tensor([(2 * column + 1 - width) / width, (height - 1 - 2 * row) / height, 1.0]).double()
        return f, (-math.inf if found is None else float(found[1] @ place)), found, place

    for b in range(batch):
        for row in range(height):
            for column in range(width):
                f, near, own, place = at(b, row, column)
                if own is None:
                    continue
                for axis, size in ((0, width), (1, height)):
                    nearer, same = [], []
                    for way in (-1, 1):
                        r, c = (row, column + way) if axis == 0 else (row - way, column)
                        if not (0 <= r < height and 0 <= c < width):
                            continue
                        g, other, plane_of_other, _ = at(b, r, c)
                        steps = [abs(float(p[1][axis])) * 2 / size for p in (own, plane_of_other) if p is not None]
                        slope = way * (image[b, :, r, c] - image[b, :, row, column])
                        step = abs(near - other)
                        one_surface = plane_of_other is not None and step <= sum(steps) + 1e-6 * max(
                            abs(near), abs(other)
                        )
                        if g == f or one_surface:
                            same.append(slope)
                        elif near > other:
                            nearer.append(slope)
                    chosen = nearer or same
                    if chosen:
                        pull = -float(grad[b, :, row, column] @ (sum(chosen) / len(chosen))) * size / 2
                        result[b, f, :, axis] += pull * (own[0] @ place)
    return result


def send(grad, image, faces, index, perspective):
    faces, image = faces.clone().requires_grad_(), image.clone().requires_grad_()
    output = opendr_gradient(image, faces, index, perspective)
    assert torch.equal(output, image)
    output.backward(grad)
    assert torch.equal(image.grad, grad)
    return faces.grad


@examples(8)
@given(
    scene=scenes(("plain", "plain", "tiny", "outside", "copy", "crossing"), most_faces=6, side=14, empty=False),
    channels=st.integers(1, 3),
)
def test_random_scenes(device, scene, channels):
    faces = scene.faces[:2]
    index = coverage(faces.to(device), scene.height, scene.width, NEAR, FAR, scene.two_sided, scene.perspective)
    image = scene.noise(len(index), channels, *index.shape[1:]).to(device)
    grad = scene.noise(*image.shape).flip(0).to(device)
    found = send(grad, image, faces.to(device), index, scene.perspective)
    expected = reference(grad, image, faces, index.cpu(), scene.perspective)
    terms = 6 * scene.height * scene.width * channels
    assert not found[..., 2].any()
    torch.testing.assert_close(
        found.cpu().double(), expected, **{**rounding(terms, float(expected.abs().max()) + 1), "rtol": 1e-4}
    )


def test_a_moving_square(device):
    """A white square of 14 x 10 pixels: each edge counts the pixels inside it, whatever the loss outside says."""
    low, high = torch.tensor([-6.0, -4.0]) / 12, torch.tensor([8.0, 6.0]) / 12  # in an image of 24 pixels
    corners = torch.tensor([[low[0], low[1]], [high[0], low[1]], [high[0], high[1]], [low[0], high[1]]])
    vertices = torch.cat((corners, torch.full((4, 1), 2.0)), 1)[None].to(device).requires_grad_()
    faces = torch.tensor([[0, 1, 2], [0, 2, 3]], device=device)
    alpha = nr.rasterize_images(
        nr.vertices_to_faces(vertices, faces), 24, outputs="alpha", anti_aliasing=False, gradient="opendr"
    ).alpha
    ramp = torch.arange(24.0, device=device)
    (moved,) = torch.autograd.grad((alpha * ramp).sum(), vertices)
    # Its columns 6 to 19 are seen. Shifted by a pixel to the right, a column of 10 enters with the weight 19 of the
    # last inner pixel, and one leaves with 6. An axis has 12 pixels for each screen unit.
    assert int(alpha.sum()) == 14 * 10
    torch.testing.assert_close(moved[0, :, 0].sum().cpu(), torch.tensor(12.0 * 10 * (19 - 6)), rtol=1e-5, atol=0)
    outside = (alpha == 0).float().detach()
    alpha = nr.rasterize_images(
        nr.vertices_to_faces(vertices, faces), 24, outputs="alpha", anti_aliasing=False, gradient="opendr"
    ).alpha
    (moved,) = torch.autograd.grad((alpha * outside * ramp).sum(), vertices)
    assert not moved.any()


def test_an_occluder_moves_and_what_it_hides_does_not(device):
    """A step between two squares at different depths moves with the nearer one."""
    near = torch.tensor([[-1.5, -1.5, 1.0], [0.01, -1.5, 1], [0.01, 1.5, 1], [-1.5, 1.5, 1]])
    back = torch.tensor([[-1.5, -1.5, 3.0], [1.5, -1.5, 3], [1.5, 1.5, 3], [-1.5, 1.5, 3]])
    order = torch.tensor([[0, 1, 2], [0, 2, 3]])
    faces = torch.cat((near[order], back[order]))[None].to(device)
    index = coverage(faces, 16, 16, NEAR, FAR, True, True)
    image = (index < 2).float()[:, None]
    found = opendr_gradient_backward(torch.ones_like(image), image, faces, index, True)
    assert found[0, :2].any() and not found[0, 2:].any()
    # 16 rows, 8 pixels for each screen unit; the corners beyond the image share it by their distances.
    torch.testing.assert_close(found[0, :2, :, 0].sum().cpu(), torch.tensor(8.0 * 16), rtol=1e-4, atol=0)


@pytest.mark.parametrize("anti_aliasing", [False, True])
@pytest.mark.parametrize("outputs", [("rgb",), ("alpha",), ("rgb", "alpha", "depth")])
def test_images(device, outputs, anti_aliasing):
    """Through `render`, `fragments` and a loss; images equal those of the other estimators."""
    mesh = nr.icosphere(1)
    vertices, faces = mesh[0].to(device).requires_grad_(), mesh[1].to(device)
    cubes = torch.rand(len(faces), 2, 2, 2, 3, device=device)
    camera = nr.Camera.look_at((0.3, 0.4, -2.7), viewing_angle=25).to(device)
    options = {"outputs": outputs, "anti_aliasing": anti_aliasing}
    found = nr.render((vertices, faces, cubes), camera, 32, gradient="opendr", **options)
    plain = nr.render((vertices, faces, cubes), camera, 32, gradient="edge", **options)
    total = 0
    for name in outputs:
        assert torch.equal(getattr(found, name), getattr(plain, name))
        total = total + getattr(found, name).square().sum()
    total.backward()
    assert vertices.grad.isfinite().all() and vertices.grad.any()
    if outputs == ("alpha",):
        vertices.grad = None
        seen = nr.fragments((vertices, faces), camera, 32, gradient="opendr", anti_aliasing=anti_aliasing)
        alpha = seen.composite(torch.ones(*seen.face_index.shape, 1, device=device))[:, 0]
        nr.losses.silhouette_iou_loss(alpha, plain.alpha.detach().flip(2)).backward()
        assert vertices.grad.isfinite().all() and vertices.grad.any()


def test_direction_of_a_growing_ball(device):
    """A ball that grows: the cosine with central differences over sub-pixel shifts is above 0.98."""
    vertices, faces = (t.to(device) for t in nr.icosphere(2, radius=0.6))
    shifts = (torch.cartesian_prod(torch.arange(6), torch.arange(6)) + 0.5) / 6 / 32
    shifts = torch.nn.functional.pad(shifts, (0, 1)).to(device)[:, None]
    camera = nr.Camera.look_at((0.0, 0.0, -2.0), orthographic=True).to(device)
    weight = torch.linspace(-1, 1, 64, device=device) + torch.linspace(0, 1, 64, device=device)[:, None]

    def loss(size):
        moved = vertices * size + shifts
        alpha = nr.render((moved, faces), camera, 64, outputs="alpha", anti_aliasing=False, gradient="opendr").alpha
        return (alpha * weight).sum((1, 2)).mean()

    size = torch.ones(3, device=device, requires_grad=True)
    (found,) = torch.autograd.grad(loss(size), size)
    steps = 0.03 * torch.eye(3, device=device)[:2]
    expected = torch.stack([(loss(size.detach() + step) - loss(size.detach() - step)) / 0.06 for step in steps])
    assert torch.cosine_similarity(found[:2], expected, dim=0) > 0.98


def test_operators(device):
    scene = Scene(2, 2, 5, 12, 9, True, True, ("plain",))
    faces = scene.faces.to(device)
    index = coverage(faces, 12, 9, NEAR, FAR, True, True)
    image = scene.noise(2, 3, 12, 9).to(device)
    leaves = image.clone().requires_grad_(), faces.clone().requires_grad_()
    torch.library.opcheck(opendr_gradient.operator, (*leaves, index, True))
    torch.library.opcheck(opendr_gradient_backward.operator, (image, image, faces, index, True))


@pytest.mark.parametrize("shape", [(0, 2, 3, 8), (1, 0, 3, 8), (1, 2, 0, 8), (1, 2, 3, 0), (1, 2, 1, 1)])
def test_empty(device, shape):
    batch, count, channels, side = shape
    faces, image = torch.rand(batch, count, 3, 3, device=device), torch.rand(batch, channels, side, 8, device=device)
    index = torch.full((batch, side, 8), -1, dtype=torch.int32, device=device)
    found = send(image, image, faces, index, True)
    assert found.shape == faces.shape and not found.any()
