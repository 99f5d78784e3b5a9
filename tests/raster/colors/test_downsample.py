"""The 2 x 2 average against torch's pooling."""

from __future__ import annotations

import torch
import torch.nn.functional as F

from neural_renderer.raster.colors.downsample import halve


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
