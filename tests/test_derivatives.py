"""Derivatives other than a plain backward pass: `torch.func`, second derivatives, forward mode, float64."""

from __future__ import annotations

import pytest
import torch
from torch.func import grad, hessian, jacrev, jvp, vmap

import neural_renderer as nr

SIZE = 12


def scene(device):
    vertices, faces = (t.to(device) for t in nr.icosphere(1))
    cubes = torch.rand(len(faces), 2, 2, 2, 3, generator=torch.Generator().manual_seed(0)).to(device)
    return vertices, faces, cubes, torch.tensor([0.3, 0.2, -2.7], device=device)


def losses(device):
    """Functions of one tensor each, through kernels of vertices, cameras, textures, light and attributes."""
    vertices, faces, cubes, eye = scene(device)
    camera = nr.Camera.look_at(eye, viewing_angle=25)
    weight = torch.linspace(-1, 1, SIZE, device=device)

    def color(vertices=vertices, cubes=cubes, eye=eye, light=None):
        camera = nr.Camera.look_at(eye, viewing_angle=25)
        rgb = nr.render((vertices, faces, cubes), camera, SIZE, outputs=("rgb",), light=light).rgb
        return (rgb.square() * weight).sum()

    def attributes(values):
        seen = nr.fragments((vertices, faces), camera, SIZE)
        return (seen.composite(seen.interpolate(values)).square() * weight).sum()

    places = torch.rand(1, 5, 5, 2, generator=torch.Generator().manual_seed(1)).to(device)

    def image(values):
        return nr.sample_texture(values, places).square().sum()

    return {
        "vertices": (lambda v: color(vertices=v), vertices),
        "camera": (lambda e: color(eye=e), eye),
        "textures": (lambda t: color(cubes=t), cubes),
        "light": (lambda d: color(light=nr.Light(direction=d)), torch.tensor([0.1, 0.9, -0.4], device=device)),
        "attributes": (attributes, vertices),
        "images": (image, torch.rand(6, 6, 3, device=device)),
    }


NAMES = ["vertices", "camera", "textures", "light", "attributes", "images"]


@pytest.mark.parametrize("name", NAMES)
def test_func_grad_and_vmap_are_backward_and_a_loop(device, name):
    loss, value = losses(device)[name]
    several = torch.stack((value, 0.9 * value))
    expected = []
    for one in several:
        leaf = one.clone().requires_grad_()
        expected.append(torch.autograd.grad(loss(leaf), leaf)[0])
    # The kernels run on the same numbers; sums of torch around them may differ by rounding.
    close = {"rtol": 1e-4, "atol": 1e-5 * float(torch.stack(expected).abs().max())}
    torch.testing.assert_close(grad(loss)(several[0]), expected[0], **close)
    torch.testing.assert_close(vmap(grad(loss))(several), torch.stack(expected), **close)
    torch.testing.assert_close(grad(lambda x: vmap(loss)(x).sum())(several), torch.stack(expected), **close)
    torch.testing.assert_close(vmap(loss)(several), torch.stack([loss(one) for one in several]), rtol=1e-5, atol=1e-5)


def test_jacobian_of_an_image(device):
    """Its product with the gradient of a loss is the loss's gradient."""
    vertices, faces, cubes, eye = scene(device)

    def draw(eye):
        return nr.render((vertices, faces, cubes), nr.Camera.look_at(eye), 4, outputs=("rgb",)).rgb

    jacobian = jacrev(draw)(eye)
    assert jacobian.shape == (1, 3, 4, 4, 3)
    expected = grad(lambda e: draw(e).sum())(eye)
    torch.testing.assert_close(jacobian.sum((0, 1, 2, 3)), expected, rtol=1e-3, atol=1e-4 * float(jacobian.abs().sum()))


@pytest.mark.parametrize("name", NAMES)
def test_second_derivatives_and_forward_mode_are_refused(device, name):
    """An error with a sentence, never a zero."""
    loss, value = losses(device)[name]
    leaf = value.clone().requires_grad_()
    (first,) = torch.autograd.grad(loss(leaf), leaf, create_graph=True)
    with pytest.raises(RuntimeError, match="the rasteriser has first derivatives only"):
        torch.autograd.grad(first.square().sum(), leaf)
    with pytest.raises(RuntimeError, match="the rasteriser has first derivatives only"):
        grad(lambda x: grad(loss)(x).square().sum())(value)
    with pytest.raises(RuntimeError, match="the rasteriser has gradients in reverse mode only"):
        jvp(loss, (value,), (value,))
    with pytest.raises(RuntimeError, match="the rasteriser has gradients in reverse mode only"):
        hessian(loss)(value)


def test_cameras_and_regularisers_have_all_derivatives(device):
    """They are plain torch: float64 in and out, forward mode, vmap, second derivatives."""
    vertices, faces, _, eye = (t.double() if t.is_floating_point() else t for t in scene(device))
    smooth = {
        "look_at": (lambda e: nr.Camera.look_at(e)(vertices), eye),
        "project": (lambda v: nr.Camera.look_at(eye)(v), vertices[:4]),
        "laplacian": (lambda v: nr.losses.laplacian(v, faces), vertices),
        "edge_length": (lambda v: nr.losses.edge_length(v, faces), vertices),
        "normal_consistency": (lambda v: nr.losses.normal_consistency(v, faces), vertices),
    }
    for function, value in smooth.values():
        leaf = value.clone().requires_grad_()
        assert function(leaf).dtype == torch.float64
        assert torch.autograd.gradcheck(function, leaf, check_forward_ad=True, check_batched_grad=True, fast_mode=True)
        assert torch.autograd.gradgradcheck(function, leaf, fast_mode=True)
