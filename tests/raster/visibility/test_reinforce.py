"""The score-function estimate `reinforce`: closed forms of its mean and of its noise."""

from __future__ import annotations

import math

import pytest
import torch

import neural_renderer as nr

COUNT = 6


def estimates(loss, parameters, repeats, **options):
    """Draw many estimates [repeats, *parameters]; their losses are a function of [S, *parameters]."""
    generator = torch.Generator().manual_seed(0)
    rows = []
    for _ in range(repeats):
        leaf = parameters.clone().requires_grad_()
        nr.reinforce(loss, leaf, generator=generator, **options).backward()
        rows.append(leaf.grad)
    return torch.stack(rows)


@pytest.mark.parametrize("antithetic", [False, True])
@pytest.mark.parametrize("samples", [2, 8])
def test_a_linear_loss(antithetic, samples):
    """The mean is the slope w, and the noise of coordinate k has a variance known in closed form.

    A term (w . e) e_k has the variance |w|² + w_k². Pairs are n = samples / 2 independent terms. With the baseline it
    is the sample covariance of losses and noise, whose variance has the divisor n - 1 (Wishart).
    """
    slope = torch.linspace(-1, 2, COUNT, dtype=torch.float64)
    repeats = 600
    found = estimates(lambda x: x @ slope + 100.0, torch.zeros(COUNT).double(), repeats, samples=samples,
                      antithetic=antithetic, spread=0.1)  # fmt: skip
    norm = slope.square().sum()
    variance = (norm + slope.square()) / (samples // 2 if antithetic else samples - 1)
    # Five standard errors of a mean.
    assert ((found.mean(0) - slope).abs() < 5 * (variance / repeats).sqrt()).all()
    # A quadratic of normal numbers has a fourth moment of at most 15 variances², which it has for a square alone.
    assert ((found.var(0) / variance - 1).abs() < 5 * math.sqrt(14 / repeats)).all()


def test_the_mean_is_the_gradient_of_the_blurred_loss():
    """A step's loss blurred by the spread s is the normal distribution function, whose slope is its density."""
    spread, place, repeats, samples = 0.3, 0.2, 200, 100
    found = estimates(lambda x: (x[:, 0] > 0).double(), torch.tensor([place]).double(), repeats, samples=samples,
                      spread=spread, antithetic=False)  # fmt: skip
    density = math.exp(-((place / spread) ** 2) / 2) / (spread * math.sqrt(2 * math.pi))
    # Each term is at most |e| / s: the variance is at most 1 / (s² samples), doubled for the baseline.
    assert abs(found.mean() - density) < 5 * math.sqrt(2 / samples / repeats) / spread


def test_a_large_constant_adds_no_noise():
    """The baseline removes it: the estimates are those of the loss without it."""

    def loss(offset):
        return lambda x: x.square().sum(1) + offset

    start = torch.ones(COUNT).double()
    for antithetic in (False, True):
        plain, shifted = (estimates(loss(c), start, 3, samples=4, antithetic=antithetic) for c in (0.0, 1e6))
        # Losses of 1e6 are rounded to 1e-10, divided by the spread of 0.01.
        torch.testing.assert_close(plain, shifted, rtol=0, atol=1e-6)


def test_pairs_see_nothing_of_an_even_loss():
    """At its minimum, the estimate of a quadratic loss by pairs is 0 up to rounding."""
    found = estimates(lambda x: x.square().sum(1), torch.zeros(COUNT).double(), 3, samples=8)
    assert found.abs().max() < 1e-15


def test_the_value_and_the_chain(device):
    """The value is the mean loss; gradients pass on to what the parameters come from."""
    leaf = torch.full((3,), 2.0, device=device, requires_grad=True)
    value = nr.reinforce(lambda x: x.sum(1), leaf * 3, samples=4, generator=torch.Generator().manual_seed(1))
    torch.testing.assert_close(value.detach(), torch.tensor(18.0, device=device))  # opposite noise cancels
    (once,) = torch.autograd.grad(2 * value, leaf, retain_graph=True)
    (again,) = torch.autograd.grad(value, leaf)
    torch.testing.assert_close(once, 2 * again)


def test_through_the_renderer(device):
    """Moving a silhouette: three quarters of the estimates of 64 samples point to within 60° of the derivative.

    With pairs, the part of n = 32 estimates along the derivative g is |g| with a variance of 2 |g|² / n, and each of
    the d - 1 = 1 others has |g|² / n. Beyond 60° needs 7 deviations of 0.18 |g| across.
    """
    vertices, faces = (t.to(device) for t in nr.icosphere(1))
    camera = nr.Camera.look_at((0.0, 0.0, -2.7), viewing_angle=30).to(device)
    ramp = torch.linspace(-1, 1, 64, device=device) + torch.linspace(-1, 1, 64, device=device)[:, None]

    def loss(moves):
        pads = torch.nn.functional.pad(moves, (0, 1))[:, None]
        return (nr.render((vertices + pads, faces), camera, 64, outputs=("alpha",)).alpha * ramp).sum((1, 2))

    start = torch.zeros(2, device=device, requires_grad=True)
    (expected,) = torch.autograd.grad(loss(start[None]).sum(), start)
    found = estimates(loss, start.detach(), 8, samples=64, spread=0.05)
    assert (torch.cosine_similarity(found, expected[None], dim=1) > 0.5).float().mean() >= 0.75


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"samples": 1}, ValueError, "samples: expected"),
        ({"samples": 3}, ValueError, "samples: expected an even number"),
        ({"spread": 0.0}, ValueError, "spread: expected"),
        ({"parameters": torch.zeros(3, dtype=torch.int64)}, TypeError, "parameters: expected"),
        ({"loss": lambda x: x}, ValueError, r"loss: expected losses of shape \[16\]"),
        ({"loss": lambda x: 1.0}, TypeError, "loss: expected a function that returns a tensor"),
    ],
)
def test_bad_arguments(options, error, message):
    arguments = {"loss": lambda x: x.sum(1), "parameters": torch.zeros(3), **options}
    with pytest.raises(error, match=message):
        nr.reinforce(**arguments)


def test_second_derivatives_and_the_argument_gradient_are_refused():
    leaf = torch.zeros(2, requires_grad=True)
    value = nr.reinforce(lambda x: x.sum(1), leaf, samples=2)
    (first,) = torch.autograd.grad(value, leaf, create_graph=True)
    with pytest.raises(RuntimeError, match="first derivatives only"):
        torch.autograd.grad(first.sum(), leaf)
    with pytest.raises(ValueError, match="needs a loss: call reinforce"):
        nr.render(nr.icosphere(0), nr.Camera.look_at((0.0, 0.0, -3.0)), 8, gradient="reinforce")
