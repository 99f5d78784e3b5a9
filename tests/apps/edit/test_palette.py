"""Palettes: distances from a painting's colours, against the usual formula."""

from __future__ import annotations

import torch

from neural_renderer.apps.edit.style import Palette
from tests.rounding import relative

# A mean of positive numbers: two roundings make a share of each, and then there is their sum.
MEAN = relative(40 * 50 + 2)


def painting() -> torch.Tensor:
    """Blue to cream with some scatter, [1, 3, 40, 50]."""
    random = torch.Generator().manual_seed(0)
    along = torch.rand(1, 1, 40, 50, generator=random)
    blue, cream = torch.tensor([0.1, 0.25, 0.45]), torch.tensor([0.9, 0.85, 0.7])
    colours = blue[:, None, None] * (1 - along) + cream[:, None, None] * along
    return colours + 0.03 * torch.randn(1, 3, 40, 50, generator=random)


def test_the_excess_is_mahalanobis_distance_beyond_two_and_a_half() -> None:
    colours = painting()[0].flatten(1).T.double()
    palette = Palette.of(painting(), torch.ones(1, 40, 50))
    torch.testing.assert_close(palette.mean.double(), colours.mean(0), **MEAN)
    covariance = torch.cov(colours.T, correction=0) + 0.02**2 * torch.eye(3)
    covariance += 0.15**2 * torch.outer(palette.mean, palette.mean)
    points = torch.rand(4, 5, 3, generator=torch.Generator().manual_seed(1))
    away = points.double() - colours.mean(0)
    distance = torch.einsum("abi,ij,abj->ab", away, torch.linalg.inv(covariance), away).sqrt()
    # Rounding of the covariance's entries moves its smallest eigenvalue the most, by the ratio of the largest to it;
    # the excess is rounded off by 0.1 where it begins.
    rounding = MEAN["rtol"] * float(torch.linalg.cond(covariance))
    expected = (distance - 2.5).clamp(min=0)
    torch.testing.assert_close(palette.excess(points).double(), expected, rtol=rounding, atol=0.1 + 2.5 * rounding)


def test_only_colours_that_the_painting_lacks_are_far() -> None:
    palette = Palette.of(painting(), torch.ones(1, 40, 50))
    own = palette.excess(painting().movedim(1, -1))
    assert (own > 0).float().mean() < 0.02
    yellow_and_pink = torch.tensor([[0.9, 0.9, 0.2], [0.9, 0.5, 0.8]], requires_grad=True)
    excess = palette.excess(yellow_and_pink)
    assert (excess > 3).all()
    excess.sum().backward()
    assert yellow_and_pink.grad is not None and (yellow_and_pink.grad != 0).all()


def test_masks_and_paintings_of_one_colour() -> None:
    half = torch.ones(1, 40, 50)
    half[..., 25:] = 0
    other = painting()
    other[..., 25:] = 0
    one, two = Palette.of(painting(), half), Palette.of(other, half)
    torch.testing.assert_close(one.mean, two.mean, **relative(2 * (40 * 50 + 2)))
    plain = Palette.of(torch.full((1, 3, 8, 8), 0.5), torch.ones(1, 8, 8))
    for allowed in ([0.52, 0.5, 0.49], [0.4, 0.4, 0.4], [0.62, 0.62, 0.62]):  # another light does not change the colour
        assert plain.excess(torch.tensor(allowed)) == 0
    assert plain.excess(torch.tensor([0.65, 0.5, 0.5])) > 2
