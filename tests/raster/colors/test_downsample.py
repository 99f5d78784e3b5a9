"""The 2 x 2 average against torch's pooling."""

from __future__ import annotations

import pytest
import torch
import torch.nn.functional as F

from neural_renderer.raster.colors.composite import composite
from neural_renderer.raster.colors.downsample import halve, in_blocks, whole
from neural_renderer.raster.colors.light_pixels import light_pixels


def test_value_and_gradient_are_those_of_average_pooling(device):
    for shape in ((2, 1, 6, 10), (1, 3, 2, 2), (0, 1, 4, 4), (3, 4, 8, 2)):
        image = torch.rand(shape, device=device).permute(0, 1, 2, 3).requires_grad_()
        halved = halve(image)
        expected = F.avg_pool2d(image, 2) if shape[0] else image[..., ::2, ::2]
        torch.testing.assert_close(halved, expected)
        assert halved.is_contiguous()
        if shape[0]:
            weight = torch.rand_like(expected)
            found, want = (torch.autograd.grad((x * weight).sum(), image)[0] for x in (halved, expected))
            torch.testing.assert_close(found, want)


def test_operator_contract(device):
    torch.library.opcheck(halve.operator, (torch.rand(2, 3, 4, 6, device=device, requires_grad=True),))


def test_the_largest_numbers_have_an_average(device):
    image = torch.full((1, 1, 2, 4), torch.finfo(torch.float32).max, device=device)
    assert torch.equal(halve(image), image[..., :1, :2])


@pytest.mark.usefixtures("deterministic")
def test_gradients_of_images_in_blocks_are_those_of_whole_images(device):
    random = torch.Generator().manual_seed(0)
    index = torch.randint(-2, 5, (2, 6, 18), generator=random, dtype=torch.int32).clamp(min=-1).to(device)
    colors, behind, light, faces = (
        torch.randn(shape, generator=random).to(device).requires_grad_()
        for shape in ((2, 6, 18, 3), (1, 3, 6, 18), (2, 2, 5, 3), (2, 5, 3, 3))
    )
    grad = torch.randn(2, 3, 3, 9, generator=random).to(device)
    for call, inputs, others in (
        (composite, (colors, behind), (index,)),
        (light_pixels, (colors, behind, light), (faces.detach(), index, True)),
    ):
        image, blocks = call(*inputs, *others), in_blocks(True, call, *inputs, *others)
        assert blocks.shape == (2, 3, 3, 2, 9, 2) and torch.equal(whole(blocks), image)
        expected = torch.autograd.grad(halve(image), inputs, grad)
        equal = torch.autograd.grad(blocks.mean((3, 5)), inputs, grad, retain_graph=True)
        second = torch.autograd.grad(blocks.mean((3, 5)), inputs, grad, create_graph=True)
        copied = torch.autograd.grad((0.25 * blocks.clone()).sum((3, 5)), inputs, grad)
        for k, want in enumerate(expected):
            assert torch.equal(equal[k], want) and torch.equal(second[k], want) and torch.equal(copied[k], want)
