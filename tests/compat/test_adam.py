"""`Adam` of the first packages: its rule, skipped elements, its state."""

from __future__ import annotations

import copy
import math

import pytest
import torch

from neural_renderer.compat.first_packages.adam import Adam


def test_follows_the_rule_and_skips_zero_gradients():
    parameter = torch.nn.Parameter(torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64))
    parameter.lr = 0.5
    optimizer = Adam([parameter], alpha=0.1, beta1=0.8, beta2=0.9, eps=1e-3)
    gradients = [[0.5, 0.0, -2.0], [0.5, 1.0, 0.0], [0.0, 0.0, 3.0]]
    expected, m, v = [1.0, 2.0, 3.0], [0.0] * 3, [0.0] * 3
    for t, gradient in enumerate(gradients, start=1):
        parameter.grad = torch.tensor(gradient, dtype=torch.float64)
        optimizer.step()
        step = 0.5 * 0.1 * math.sqrt(1 - 0.9**t) / (1 - 0.8**t)
        for i, g in enumerate(gradient):
            if g != 0:
                m[i] += (1 - 0.8) * (g - m[i])
                v[i] += (1 - 0.9) * (g * g - v[i])
                expected[i] -= step * m[i] / (math.sqrt(v[i]) + 1e-3)
        torch.testing.assert_close(parameter.detach(), torch.tensor(expected, dtype=torch.float64))


def test_agrees_with_torch_where_no_gradient_is_zero():
    ours = torch.nn.Parameter(torch.linspace(-1, 1, 6, dtype=torch.float64))
    theirs = torch.nn.Parameter(ours.detach().clone())
    # With eps = 0 the two ways of writing the rule are the same; 1e-300 is as good.
    pair = [(ours, Adam([ours], lr=0.01, eps=1e-300)), (theirs, torch.optim.Adam([theirs], lr=0.01, eps=1e-300))]
    for _ in range(10):
        for parameter, optimizer in pair:
            optimizer.zero_grad()
            (parameter - 3).square().sum().backward()
            optimizer.step()
    torch.testing.assert_close(ours, theirs)


def test_state_survives_saving():
    def train(parameter, optimizer, steps):
        for _ in range(steps):
            optimizer.zero_grad()
            parameter.square().sum().backward()
            optimizer.step()

    parameter = torch.nn.Parameter(torch.tensor([1.0, -2.0, 0.0]))
    optimizer = Adam([parameter], lr=0.1)
    train(parameter, optimizer, 3)
    other = torch.nn.Parameter(parameter.detach().clone())
    resumed = Adam([other], lr=0.9)
    resumed.load_state_dict(copy.deepcopy(optimizer.state_dict()))
    train(parameter, optimizer, 3)
    train(other, resumed, 3)
    assert torch.equal(parameter, other) and parameter[2] == 0


@pytest.mark.parametrize("dtype", [torch.float16, torch.bfloat16])
def test_half_parameters_move_as_those_of_float32(dtype):
    """Where squares of gradients and eps are 0 in half precision; after a checkpoint, too."""
    wide = torch.nn.Parameter(torch.ones(5))
    half = torch.nn.Parameter(torch.ones(5, dtype=dtype))
    pair = [(wide, Adam([wide], lr=0.1)), (half, Adam([half], lr=0.1))]
    for step in range(4):
        if step == 2:
            saved = copy.deepcopy(pair[1][1].state_dict())
            pair[1] = half, Adam([half])
            pair[1][1].load_state_dict(saved)
        gradient = torch.tensor([0, 1e-4, 1e-6, -1, (-3.0) ** step]).to(dtype)
        for parameter, optimizer in pair:
            parameter.grad = gradient.to(parameter.dtype)
            optimizer.step()
    # Each of the four steps is rounded by at most half an eps of numbers below 2.
    torch.testing.assert_close(half.float(), wide, rtol=0, atol=4 * torch.finfo(dtype).eps)
    assert half.dtype == dtype and half[0] == 1


def test_closure_groups_and_scheduler():
    a, b = torch.nn.Parameter(torch.ones(2)), torch.nn.Parameter(torch.ones(2))
    optimizer = Adam([{"params": [a]}, {"params": [b], "lr": 0.0}], lr=0.1)

    def closure():
        optimizer.zero_grad()
        loss = (a * b).sum()
        loss.backward()
        return loss

    scheduler = torch.optim.lr_scheduler.StepLR(optimizer, 1)
    assert optimizer.step(closure) == 2
    scheduler.step()
    assert optimizer.param_groups[0]["lr"] == pytest.approx(0.01)
    torch.testing.assert_close(a.detach(), torch.full((2,), 0.9))
    assert torch.equal(b, torch.ones(2))
    optimizer.zero_grad()
    optimizer.step()  # without gradients nothing happens
    torch.testing.assert_close(a.detach(), torch.full((2,), 0.9))


@pytest.mark.parametrize("wrong", [{"lr": -1}, {"eps": 0}, {"beta1": 1.0}, {"betas": (0.9, -0.1)}, {"alpha": math.nan}])
def test_rates_out_of_range_are_named(wrong):
    with pytest.raises(ValueError, match="expected a"):
        Adam([torch.nn.Parameter(torch.ones(1))], **wrong)


@pytest.mark.parametrize("betas", [(0.9,), (0.9, 0.99, 0.999), 0.9, None, "ab", (None, 0.9), ("0.9", 0.9)])
def test_betas_that_are_not_two_numbers_are_named(betas):
    parameter = torch.nn.Parameter(torch.ones(1))
    for parameters, options in (([parameter], {"betas": betas}), ([{"params": [parameter], "betas": betas}], {})):
        with pytest.raises(
            (TypeError, ValueError), match=r"^(betas: expected two numbers|beta1: expected a number), got"
        ):
            Adam(parameters, **options)


def test_sparse_gradients_are_refused():
    parameter = torch.nn.Parameter(torch.ones(2))
    parameter.grad = torch.ones(2).to_sparse()
    with pytest.raises(TypeError, match="gradient: expected a dense"):
        Adam([parameter]).step()


def test_pieces_do_not_matter(monkeypatch):
    """Large parameters are moved piece by piece, in any memory format, to the same numbers."""
    found = []
    for piece in (1 << 40, 7):
        monkeypatch.setattr("neural_renderer.compat.first_packages.adam._PIECE", piece)
        torch.manual_seed(0)
        image = torch.randn(8, 4, 5, 5).to(memory_format=torch.channels_last)
        values = [
            torch.nn.Parameter(value) for value in (torch.randn(64, 33), image, torch.randn(()), torch.randn(9).half())
        ]
        optimiser = Adam(values, lr=1e-2)
        for _ in range(3):
            for value in values:
                value.grad = torch.randn_like(value) * (torch.rand_like(value) > 0.3)
            optimiser.step()
        found.append(values)
    for one, other in zip(*found, strict=True):
        assert torch.equal(one, other)
