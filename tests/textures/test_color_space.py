"""sRGB and linear light."""

from __future__ import annotations

import pytest
import torch

import neural_renderer as nr


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


def test_whole_numbers_are_refused():
    with pytest.raises(TypeError, match=r"color: expected a floating tensor, got torch\.uint8"):
        nr.srgb_to_linear(torch.zeros(3, dtype=torch.uint8))
