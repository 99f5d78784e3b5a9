"""The gradient through several layers: against its reference, and against the derivative of pictures."""

from __future__ import annotations

import itertools

import pytest
import torch

import neural_renderer as nr
from neural_renderer.raster.ops.peel import peel
from neural_renderer.raster.visibility.edge import EdgeOptions, edge_gradient
from tests.raster.reference.edge import edge_gradient_reference
from tests.raster.scenes import FAR, NEAR, Scene
from tests.raster.visibility.checks import ball, jittered


def compare(
    device: str, faces: torch.Tensor, height: int, width: int, options: tuple[bool, bool, bool]
) -> torch.Tensor:
    """Assert that kernels and reference agree; returns counts of faces. Both as `compare` of `checks`."""
    two_sided, perspective = options[:2]
    shown = peel(faces.to(device), height, width, NEAR, FAR, two_sided, perspective, 3)
    random = torch.Generator().manual_seed(0)
    maps = torch.randn(5, len(faces), 2, height, width, generator=random)
    image, grad, pictures = maps[0], maps[1], maps[2:]
    moved = faces.to(device).requires_grad_()
    output = edge_gradient(image.to(device), moved, shown, EdgeOptions(*options), *[None] * 5, pictures.to(device))
    assert torch.equal(output.cpu(), image)
    output.backward(grad.to(device))

    def expected(corners: torch.Tensor) -> torch.Tensor:
        each = zip(shown.cpu(), pictures, strict=True)
        return sum(edge_gradient_reference(grad, own, corners, i, *options, layered=True) for i, own in each)

    exact = expected(faces)
    spread = torch.stack([(expected(jittered(faces, n)) - exact).abs().flatten(2).amax(2) for n in range(4)]).amax(0)
    size = exact.abs().flatten(2).amax(2)
    difference = (moved.grad.cpu() - exact).abs().flatten(2).amax(2)
    known = spread < 1e-2 * size + 1e-6
    assert (difference <= 3 * spread + 1e-4 * size + 1e-5)[known].all()
    return torch.tensor([(known & (size > 0)).sum(), (size > 0).sum()])


@pytest.mark.parametrize("perspective", [False, True])
@pytest.mark.parametrize("seams", [False, True])
def test_random_scenes(device, perspective, seams):
    compared = torch.zeros(2)
    for seed in range(2):
        faces = Scene(seed, 1, 8, 20, 27, True, perspective, ("plain", "outside", "tiny")).faces
        compared += compare(device, faces, 20, 27, (seed % 2 == 0, perspective, seams))
    compared += compare(device, ball(0, 1, 0.1), 20, 27, (True, perspective, seams))
    assert compared[0] >= 0.8 * compared[1] and compared[1] >= 15


def picture(vertices, faces, size, opacity, gradient="edge", layers: int | None = 4, seams=True):
    """Draw faces of different shades of grey."""
    camera = nr.Camera.look_at((0.0, 0.0, -3.0), viewing_angle=25)
    options = {"anti_aliasing": False, "gradient": gradient}
    shades = torch.linspace(0.1, 0.9, len(faces), device=vertices.device)[:, None, None].expand(-1, 3, 1)
    if layers is None:
        found = nr.fragments((vertices, faces), camera, size, **options)
        return found.composite(found.interpolate(shades), 0.2, seams=seams)
    found = nr.fragments((vertices, faces), camera, size, layers=layers, **options)
    return found.composite([layer.interpolate(shades) for layer in found], opacity, 0.2, seams=seams)


def weights(size: int) -> torch.Tensor:
    """A smooth function over the picture."""
    at = (torch.arange(size, dtype=torch.float64) + 0.5) / size
    return (torch.sin(5 * at)[:, None] + torch.cos(4 * at + 1)[None]) / size**2


def two_bodies() -> tuple[torch.Tensor, torch.Tensor]:
    """Two closed bodies that intersect."""
    one, faces = nr.icosphere(0, 0.55)
    two = 0.8 * one.flip(1) + torch.tensor([0.31, 0.12, 0.24])
    return torch.cat((one, two)), torch.cat((faces, faces + len(one)))


@pytest.mark.parametrize("opacity", [0.4, 1.0])
def test_the_derivative_of_pictures(opacity):
    """Outlines where a front and a back end at once, inner outlines, seams and intersections.

    The mean of the estimate over shifts of the pixel grid is the difference of large pictures of moved bodies, which
    have an error of some 3e-4 from the pixels at edges; the estimate's is 1e-4.
    """
    body, faces = two_bodies()
    random = torch.Generator().manual_seed(3)
    motions = 0.5 * torch.randn(3, *body.shape, generator=random) * torch.tensor([1, 1, 0.3])
    step, grad = 4e-3, torch.zeros_like(body)
    camera_shifts = (torch.rand(16, 2, generator=random) - 0.5) * 2 * 1.33 / 96
    for shift in torch.cat((camera_shifts, -camera_shifts)):
        moved = (body + torch.nn.functional.pad(shift, (0, 1))).requires_grad_()
        (picture(moved, faces, 96, opacity)[0, 0] * weights(96)).sum().backward()
        grad += moved.grad / (2 * len(camera_shifts))
    for motion in motions:
        expected = 0.0
        for sign, shift in itertools.product((1, -1), torch.rand(4, 3, generator=random) * 1.33 / 512):
            with torch.no_grad():
                image = picture(body + sign * step * motion + shift, faces, 1024, opacity)[0, 0]
            expected += sign * float((image * weights(1024)).sum()) / (8 * step)
        assert float((grad * motion).sum()) == pytest.approx(expected, abs=8e-4)


@pytest.mark.usefixtures("deterministic")
@pytest.mark.parametrize("gradient", ["edge", "nmr"])
@pytest.mark.parametrize("seams", [False, True])
@pytest.mark.parametrize("bodies", [1, 2])
def test_opaque_layers_are_the_visible_faces(device, gradient, seams, bodies):
    """With an opacity of 1, the picture and its gradient are those without layers, to the bit.

    But where a hidden body and the one in front of it end between the same two pixel centres, `edge` counts the end
    of the one in front twice.
    """
    body, faces = nr.icosphere(0, 0.55) if bodies == 1 else two_bodies()
    random, results = torch.rand(1, 1, 40, 40, generator=torch.Generator().manual_seed(0)).to(device), []
    for layers in (None, 3):
        vertices = body.to(device, copy=True).requires_grad_()
        image = picture(vertices, faces.to(device), 40, 1.0, gradient, layers, seams)
        results.append((image.detach(), *torch.autograd.grad((image * random).sum(), vertices)))
    (image, grad), (layered, layered_grad) = results
    assert torch.equal(layered, image)
    if bodies == 1 or gradient == "nmr":
        assert torch.equal(layered_grad, grad)
    else:
        assert (layered_grad - grad).norm() < 0.02 * grad.norm()


def test_every_layer_has_a_gradient_of_nmr(device):
    """The outline of a pane behind another one pulls at its corners, by the share that passes the pane in front."""
    pane = torch.tensor([[-0.5, -0.4, 0.0], [0.5, -0.4, 0.0], [0.0, 0.5, 0.0]], device=device)
    vertices = torch.cat((1.5 * pane, pane + torch.tensor([0.0, 0, 0.5], device=device))).requires_grad_()
    faces = torch.tensor([[0, 1, 2], [3, 4, 5]], device=device)
    (hidden,) = torch.autograd.grad(picture(vertices, faces, 48, 1.0, "nmr").sum(), vertices)
    (half,) = torch.autograd.grad(picture(vertices, faces, 48, 0.5, "nmr").sum(), vertices)
    assert not hidden[3:].any() and half[3:, :2].any(1).all()
