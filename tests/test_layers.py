"""`Layers`: the blend of layers, its gradients, and what does not fit."""

from __future__ import annotations

import pytest
import torch

import neural_renderer as nr
from tests.raster.reference.drawing import peel_reference

CAMERA = nr.Camera.look_at((0.3, 0.4, -3.0), viewing_angle=25)


def scene() -> tuple[torch.Tensor, torch.Tensor]:
    """Two spheres, one in the other."""
    vertices, faces = nr.icosphere(1, 0.9)
    return torch.cat((vertices, 0.5 * vertices)), torch.cat((faces, faces + len(vertices)))


@pytest.mark.parametrize("anti_aliasing", [False, True])
def test_the_blend_is_that_of_the_reference(device, anti_aliasing) -> None:
    """Values, and gradients to colours, opacities and the background, in float64 pixel by pixel."""
    vertices, faces = scene()
    layers = nr.fragments(
        (vertices.to(device), faces.to(device)), CAMERA, (12, 15), layers=3, anti_aliasing=anti_aliasing
    )
    size = layers[0].face_index.shape[1:]
    shown = peel_reference(layers[0].corners.cpu(), *size, 0.1, 100.0, True, True, 3)
    assert torch.equal(torch.stack([layer.face_index.cpu() for layer in layers]), shown)

    random = torch.Generator().manual_seed(0)
    colors = torch.rand(3, 1, *size, 2, generator=random)
    opacity = torch.rand(3, 1, *size, 1, generator=random)
    background, pull = torch.rand(2, generator=random), torch.rand(1, 2, 12, 15, generator=random)
    results = []
    for dtype in (torch.float32, torch.float64):
        parts = [part.detach().to(device, dtype, copy=True).requires_grad_() for part in (colors, opacity, background)]
        if dtype == torch.float32:
            image = layers.composite(*parts)
        else:
            c, a, rest = parts
            picture = rest.expand(1, *size, 2)
            for k in (2, 1, 0):
                mix = a[k] * c[k] + (1 - a[k]) * picture
                picture = torch.where((shown[k] >= 0)[..., None].to(device), mix, picture)
            image = picture.movedim(3, 1)
            image = torch.nn.functional.avg_pool2d(image, 2) if anti_aliasing else image
        (image * pull.to(device, dtype)).sum().backward()
        results.append((image.detach(), *(part.grad for part in parts)))
    for got, expected in zip(*results, strict=True):
        # Some ten operations with numbers of at most 1; the background's gradient is a sum of 720 of them.
        torch.testing.assert_close(got.double(), expected, rtol=1e-5, atol=2e-6)


def test_forms_of_opacity_are_equal() -> None:
    layers = nr.fragments(scene(), CAMERA, 16, layers=2)
    colors = torch.rand(2, *layers[0].face_index.shape, 3)
    alpha = torch.full((2, *layers[0].face_index.shape), 0.25)
    expected = layers.composite(colors, 0.25)
    for form in (torch.tensor(0.25), alpha, alpha[..., None], list(alpha), [part[..., None] for part in alpha]):
        assert torch.equal(layers.composite(list(colors), form), expected)


def test_cut_outs_show_what_is_behind() -> None:
    """Where the outer sphere's opacity is 0, the picture is that of the inner sphere alone."""
    vertices, faces = scene()
    layers = nr.fragments((vertices, faces), CAMERA, 24, layers=4, anti_aliasing=False)
    outer = len(faces) // 2
    alpha = [(layer.face_index >= outer).float() for layer in layers]
    colors = [layer.interpolate(vertices) for layer in layers]
    inner = nr.fragments((vertices, faces[outer:]), CAMERA, 24, anti_aliasing=False)
    # The weights of a point in two drawings of one face are equal.
    assert torch.equal(layers.composite(colors, alpha, 0.5), inner.composite(inner.interpolate(vertices), 0.5))


def test_a_sequence_of_fragments() -> None:
    layers = nr.fragments(scene(), CAMERA, 8, layers=3)
    assert len(layers) == 3 and list(layers) == [layers[0], layers[1], layers[-1]]
    depth = torch.stack([layer.depth for layer in layers])
    assert (depth[1:] >= depth[:-1]).all()


@pytest.mark.parametrize(
    ("message", "colors", "opacity"),
    [
        ("colors: expected a tensor for each of 2 layers, got 3", (3, 1, 16, 16, 3), 0.5),
        ("colors: expected shape", (2, 1, 8, 8, 3), 0.5),
        ("opacity: expected a tensor for each of 2 layers, got 1", (2, 1, 16, 16, 3), (1, 1, 16, 16)),
        ("opacity: expected shape", (2, 1, 16, 16, 3), (2, 1, 16, 16, 3)),
        ("opacity: expected finite", (2, 1, 16, 16, 3), float("nan")),
    ],
)
def test_what_does_not_fit(message, colors, opacity) -> None:
    layers = nr.fragments(scene(), CAMERA, 8, layers=2)
    alpha = torch.rand(opacity) if isinstance(opacity, tuple) else opacity
    with pytest.raises(ValueError, match=message):
        layers.composite(torch.rand(colors), alpha)
    with pytest.raises(TypeError, match="colors: expected a tensor for each layer"):
        layers.composite("red", 0.5)
    with pytest.raises(ValueError, match="layers: expected"):
        nr.fragments(scene(), CAMERA, 8, layers=0)
