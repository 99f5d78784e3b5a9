"""sRGB and linear light."""

from __future__ import annotations

import pytest
import torch

import neural_renderer as nr
from neural_renderer.textures.color_space import tinted


def test_values_of_the_standard():
    """Codes of 8 bits and their linear values, from tables of IEC 61966-2-1."""
    codes = torch.tensor([0, 10, 11, 64, 128, 188, 255], dtype=torch.float64) / 255
    linear = torch.tensor([0, 0.0030353, 0.0033465, 0.0512695, 0.2158605, 0.5028865, 1], dtype=torch.float64)
    torch.testing.assert_close(nr.srgb_to_linear(codes), linear, rtol=0, atol=5e-8)
    torch.testing.assert_close(nr.linear_to_srgb(linear), codes, rtol=0, atol=1e-6)


def test_they_are_inverse_beyond_one_and_differentiable_everywhere():
    values = torch.cat((torch.linspace(-0.5, 3, 500), torch.tensor([0.0, 0.04045, 0.0031308]))).double()
    torch.testing.assert_close(nr.srgb_to_linear(nr.linear_to_srgb(values)), values, rtol=0, atol=1e-6)
    for function in (nr.srgb_to_linear, nr.linear_to_srgb):
        leaf = values.clone().requires_grad_()
        function(leaf).sum().backward()
        assert (leaf.grad > 0).all() and leaf.grad.isfinite().all()


@pytest.mark.parametrize("factors", [(3,), (4, 3)])
def test_derivatives_of_a_tint(factors):
    """First and second ones, in both modes and in batches, beside those of finite differences."""
    generator = torch.Generator().manual_seed(0)
    color = torch.rand(4, 3, generator=generator, dtype=torch.float64)
    color[0, 0] = 0.02  # on the straight part of both curves
    inputs = color.requires_grad_(), (0.1 + torch.rand(factors, generator=generator).double()).requires_grad_()
    several = {"check_forward_ad": True, "check_batched_grad": True, "check_batched_forward_grad": True}
    assert torch.autograd.gradcheck(tinted, inputs, **several)
    assert torch.autograd.gradgradcheck(tinted, inputs, check_fwd_over_rev=True, check_rev_over_rev=True)


def test_whole_numbers_are_refused():
    with pytest.raises(TypeError, match=r"color: expected a floating tensor, got torch\.uint8"):
        nr.srgb_to_linear(torch.zeros(3, dtype=torch.uint8))
