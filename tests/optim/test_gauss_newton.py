"""Gauss-Newton on problems with known solutions, and on images."""

from __future__ import annotations

import math

import pytest
import torch

import neural_renderer as nr
from neural_renderer.optim import GaussNewton, pyramid
from neural_renderer.optim.residuals import Residuals
from neural_renderer.optim.robust import LOSSES


def rosenbrock(x):
    """Residuals that are 0 at (1, 1), at the end of a curved valley."""
    return torch.stack((10 * (x[1] - x[0] ** 2), 1 - x[0]))


@pytest.mark.parametrize("most_columns", [0, 64])
@pytest.mark.parametrize("reads", [False, True])
def test_curved_valley(most_columns, reads):
    """By columns and by products, of closures with and without arguments."""
    x = torch.tensor([-1.2, 1.0], dtype=torch.float64, requires_grad=True)
    optimizer = GaussNewton([x], most_columns=most_columns)
    losses = [float(optimizer.step((lambda: rosenbrock(x)) if reads else rosenbrock)) for _ in range(40)]
    assert losses == sorted(losses, reverse=True)
    assert losses[-1] < 1e-12
    torch.testing.assert_close(x, torch.ones_like(x), rtol=0, atol=1e-5)


def line(loss, outliers=5):
    """Fit a line through points of which some are far away; returns its two parameters."""
    at = torch.linspace(-1, 1, 40, dtype=torch.float64)
    values = 2 * at + 0.5
    values[:outliers] += 10
    x = torch.zeros(2, dtype=torch.float64)
    optimizer = GaussNewton([x], loss=loss, scale=0.5)
    for _ in range(40):
        optimizer.step(lambda x: x[0] * at + x[1] - values)
    return x


def test_linear_problem_takes_one_step():
    at = torch.linspace(-1, 1, 40, dtype=torch.float64)
    x = torch.zeros(2, dtype=torch.float64)
    loss = GaussNewton([x], damping=1e-9).step(lambda x: x[0] * at + x[1] - (2 * at + 0.5))
    assert float(loss) < 1e-15  # the damping's share of the solution, squared
    torch.testing.assert_close(x, torch.tensor([2.0, 0.5], dtype=torch.float64), rtol=1e-7, atol=1e-7)


def test_robust_losses_ignore_outliers():
    """Squares are drawn towards the outliers. The weight of an outlier falls in the order of the losses."""
    right = torch.tensor([2.0, 0.5], dtype=torch.float64)
    errors = {loss: float((line(loss) - right).norm()) for loss in LOSSES}
    assert errors["squares"] > 1
    assert errors["squares"] > errors["huber"] > errors["cauchy"] > errors["geman_mcclure"]
    assert errors["geman_mcclure"] < 0.01


@pytest.mark.parametrize("loss", LOSSES)
def test_weights_are_derivatives(loss):
    s = torch.linspace(0.01, 5, 50, dtype=torch.float64, requires_grad=True)
    rho, weights = LOSSES[loss](s)
    (slope,) = torch.autograd.grad(rho.sum(), s)
    torch.testing.assert_close(slope, weights)


@pytest.mark.parametrize("most_columns", [0, 64])
def test_bounds(most_columns):
    """The solution (2, 0.5) is out of reach: a parameter stays at its bound, and the other one is best given that."""
    at = torch.linspace(-1, 1, 40, dtype=torch.float64) + 0.3
    x, y = torch.zeros(1, dtype=torch.float64), torch.zeros(1, dtype=torch.float64)
    groups = [{"params": [x], "bounds": (-1.0, 1.5)}, {"params": [y]}]
    optimizer = GaussNewton(groups, most_columns=most_columns)
    for _ in range(20):
        optimizer.step(lambda x, y: x * at + y - (2 * at + 0.5))
    assert float(x) == 1.5
    torch.testing.assert_close(y[0], (0.5 * at + 0.5).mean(), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("bounds", [(2.0, 1.0), (0.0, None), (math.nan, 1.0), 1.0, (0.0,), ("a", "b")])
def test_wrong_bounds(bounds):
    with pytest.raises(ValueError, match="bounds: expected a pair"):
        GaussNewton([{"params": [torch.zeros(1)], "bounds": bounds}])


def test_a_start_beyond_the_bounds_is_moved_there():
    x = torch.full((1,), -5.0)
    GaussNewton([{"params": [x], "bounds": (0.0, 1.0)}]).step(lambda x: x + 7)
    assert float(x) == 0.0


def test_arguments_with_defaults_are_not_parameters():
    x, target = torch.zeros(2, requires_grad=True), torch.tensor([1.0, 2.0])
    optimizer = GaussNewton([x])
    for _ in range(4):
        optimizer.step(lambda goal=target: x - goal)
    torch.testing.assert_close(x.detach(), target, rtol=1e-4, atol=1e-4)


def test_trust_region():
    """A step moves no position farther than the limit."""
    x = torch.zeros(2, dtype=torch.float64)
    optimizer = GaussNewton([x], positions=lambda x: 10 * x[None], pixels=3.0)
    for n in range(1, 6):
        optimizer.step(lambda x: x - torch.tensor([30.0, 40.0], dtype=torch.float64))
        torch.testing.assert_close(x.norm(), torch.tensor(0.3 * n, dtype=torch.float64), rtol=1e-6, atol=0)


def test_state_is_saved():
    x, y = (torch.tensor([-1.2, 1.0], dtype=torch.float64) for _ in range(2))
    first = GaussNewton([x])
    for _ in range(5):
        first.step(rosenbrock)
    second = GaussNewton([y])
    second.load_state_dict(first.state_dict())
    with torch.no_grad():
        y.copy_(x)
    assert float(first.step(rosenbrock)) == float(second.step(rosenbrock))
    assert torch.equal(x, y)


def test_no_step_raises_the_loss():
    """At the minimum, and where residuals away from the start are not finite, parameters stay as they are."""
    x = torch.tensor([1.0, 1.0], dtype=torch.float64)
    assert float(GaussNewton([x]).step(rosenbrock)) == 0
    assert x.tolist() == [1, 1]
    y = torch.zeros(1, dtype=torch.float64)
    GaussNewton([y]).step(lambda y: torch.where(y == 0, 1 + y, torch.nan * y))
    assert y.tolist() == [0]


@pytest.mark.parametrize("most_columns", [0, 64])
def test_a_stationary_start_stays(most_columns):
    x = torch.zeros(2)
    assert float(GaussNewton([x], most_columns=most_columns).step(lambda x: 1 + x**2)) == 1
    assert x.tolist() == [0, 0]


def test_groups_may_come_later():
    x, y = torch.zeros(1), torch.zeros(1)
    optimizer = GaussNewton([x], damping=1e-9)
    optimizer.add_param_group({"params": [y], "bounds": (0.0, 2.0)})
    optimizer.step(lambda x, y: torch.cat((x - 1, y - 3)))
    torch.testing.assert_close(torch.cat((x, y)), torch.tensor([1.0, 2.0]))


@pytest.mark.parametrize("most_columns", [0, 64])
@pytest.mark.parametrize("bounds", [None, (-9.0, 1.0)])
def test_a_goal_may_move_after_convergence(most_columns, bounds):
    """Damping does not grow while nothing is left to gain: at a minimum, or at a bound that holds the solution."""
    x, goal = torch.zeros(2), torch.tensor([1.0, 5.0])

    def residuals(x):
        return torch.cat((x - goal, 0.3 * torch.sin(x - goal) + 0.1))

    optimizer = GaussNewton([{"params": [x], "bounds": bounds}], most_columns=most_columns)
    for _ in range(12):
        optimizer.step(residuals)
    before = x.clone()
    goal = torch.tensor([-3.0, -4.0])
    for _ in range(6):
        optimizer.step(residuals)
    torch.testing.assert_close(x - goal, before[:1].expand(2) - 1, rtol=0, atol=1e-3)  # the minimum's place


def test_nothing_is_tried_where_the_loss_cannot_fall():
    """At a minimum, and where a bound holds all parameters, a step costs the residuals and their derivatives."""
    calls = []

    def residuals(x):
        calls.append(x)
        return torch.cat((x - 5, 0.3 * torch.sin(x) + 1))

    for bounds in (None, (0.0, 1.0)):
        optimizer = GaussNewton([{"params": [torch.zeros(2)], "bounds": bounds}])
        for _ in range(12):
            calls.clear()
            optimizer.step(residuals)
        assert len(calls) == 1


@pytest.mark.parametrize("damping", [1e-3, 1e-9])
def test_parameters_added_after_failing_steps_move(damping):
    """Damping grows from step to step while no trial lowers the loss, such as in noise."""
    x, y, tried = torch.zeros(1), torch.zeros(1), []

    def noisy(x):  # each motion of x seems to gain, and none does
        tried.append(float(x.detach().abs()))
        return 1 + x + torch.where(x.detach() == 0, 0.0, 9.0)

    optimizer = GaussNewton([x], damping=damping)
    for _ in range(9):
        optimizer.step(noisy)
    assert min(each for each in tried if each) < 1e-4
    optimizer.add_param_group({"params": [y]})
    x += 1
    for _ in range(12):
        optimizer.step(lambda x, y: torch.cat((x - 3, torch.exp(y) - 5)))
    torch.testing.assert_close(torch.cat((x, y)), torch.tensor([3.0, math.log(5)]), rtol=1e-4, atol=0)


def test_in_inference_mode():
    """Columns are derivatives there, too; products would need what the mode does not record."""
    with torch.inference_mode():
        x = torch.tensor([-1.2, 1.0], dtype=torch.float64)
        optimizer = GaussNewton([x])
        for _ in range(40):
            optimizer.step(rosenbrock)
        torch.testing.assert_close(x, torch.ones_like(x), rtol=0, atol=1e-5)
        for closure, most_columns in ((rosenbrock, 0), (lambda: rosenbrock(x), 64)):
            with pytest.raises(ValueError, match=r"that depend on the parameters, got torch\.inference_mode"):
                GaussNewton([x], most_columns=most_columns).step(closure)


def test_arguments_are_checked():
    x = torch.zeros(2)
    for options, message in (
        ({"loss": "l1"}, "loss: expected one of squares, huber"),
        ({"damping": 0.0}, "damping: expected a finite number above 0, got 0"),
        ({"pixels": -1.0}, "pixels: expected a finite number above 0"),
    ):
        with pytest.raises(ValueError, match=message):
            GaussNewton([x], **options)
    with pytest.raises(ValueError, match="closure: expected finite residuals"):
        GaussNewton([x]).step(lambda x: x * torch.nan)
    with pytest.raises(TypeError, match="closure: expected a floating tensor"):
        GaussNewton([x]).step(lambda x: x.long())
    with pytest.raises(TypeError, match="closure: expected a floating tensor of residuals or several, got NoneType"):
        GaussNewton([x]).step(lambda x: None)
    with pytest.raises(TypeError, match=r"params\[0\]: expected a floating-point tensor"):
        GaussNewton([torch.zeros(2, dtype=torch.long)])
    for name in ("positions", "preconditioner"):
        with pytest.raises(TypeError, match=f"{name}: expected a function or None, got int"):
            GaussNewton([x], positions=3) if name == "positions" else GaussNewton([{"params": [x], name: 3}])
    with pytest.raises(ValueError, match=r"params: expected options of a group among bounds, .*, got 'bund'"):
        GaussNewton([{"params": [x], "bund": (0.0, 1.0)}])
    with pytest.raises(ValueError, match=r"params\[1\]: expected at least one number, got \[0\] float32"):
        GaussNewton([x, torch.zeros(0)])
    with pytest.raises(ValueError, match="positions: expected finite motions of points, got NaN"):
        GaussNewton([x], positions=lambda x: x[None] * torch.nan).step(lambda x: x - 1)
    leaf = torch.zeros(2, requires_grad=True)
    for most_columns in (0, 64):
        with pytest.raises(TypeError, match=r"closure: expected a function that returns residuals .* calls backward"):
            GaussNewton([leaf], most_columns=most_columns).step(lambda: (leaf - 1).square().sum().backward())
        with pytest.raises(ValueError, match="closure: expected residuals that depend on the parameters"):
            GaussNewton([x], most_columns=most_columns).step(lambda x: torch.ones(3))
        with pytest.raises(ValueError, match="closure: expected residuals, got empty tensors"):
            GaussNewton([x], most_columns=most_columns).step(lambda x: x[:0])
    with pytest.raises(ValueError, match="bounds: expected a pair"):
        GaussNewton([x]).add_param_group({"params": [torch.zeros(1)], "bounds": (1.0, 0.0)})
    with pytest.raises(ValueError, match=r"bounds: .* that broadcast to each parameter"):
        GaussNewton([{"params": [x], "bounds": (torch.zeros(3), torch.ones(3))}])
    with pytest.raises(TypeError, match="closure: expected an argument shift, as shifts is 3, got none"):
        GaussNewton([x], shifts=3).step(lambda x: x)
    with pytest.raises(ValueError, match="levels"):
        pyramid(torch.zeros(1, 4, 4), 0)


def test_pyramid():
    image = torch.arange(48.0).view(1, 6, 8)
    fine, middle, coarse = pyramid(image, 3)
    assert torch.equal(fine, image)
    torch.testing.assert_close(middle, 2 * image.view(1, 3, 2, 4, 2).mean((2, 4)))
    assert coarse.shape == (1, 1, 2)
    assert [level.shape for level in pyramid(image, 9, skip=1)] == [(1, 3, 4), (1, 1, 2)]


def test_pose_of_an_object():
    """Six numbers of a pose, from a picture: within a hundredth of a radian and of its size after a dozen steps."""
    vertices, faces = nr.icosphere(2)
    vertices = 0.6 * vertices * torch.tensor([1.2, 0.9, 0.6])
    colors = (0.6 + 0.3 * torch.sin(4 * vertices[faces.long()].mean(1)))[:, None, None, None]
    camera = nr.Camera.look_at((0.4, 0.5, 2.7), viewing_angle=20)

    def draw(turn, shift):
        x, y, z = turn
        zero = torch.zeros_like(x)
        rotation = torch.linalg.matrix_exp(torch.stack((zero, -z, y, z, zero, -x, -y, x, zero)).view(3, 3))
        return nr.render((vertices @ rotation.T + shift, faces, colors), camera, 48, outputs=("rgb",)).rgb

    goal = torch.tensor([0.2, -0.15, 0.1]), torch.tensor([0.05, -0.04, 0.06])
    target, own = draw(*goal), (torch.zeros(3), torch.zeros(3))
    optimizer = GaussNewton(own)
    for _ in range(12):
        loss = optimizer.step(lambda *pose: pyramid(draw(*pose) - target, 5))
    assert float(loss) < 0.05
    for found, right in zip(own, goal, strict=True):
        torch.testing.assert_close(found, right, rtol=0, atol=0.01)


@pytest.mark.parametrize("reads", [False, True])
def test_averages_over_sub_pixel_shifts(reads):
    """Shifts have a mean of 0, so an average of residuals that are linear in them is what a single one at 0 is."""
    x, seen = torch.tensor([3.0, 4.0], requires_grad=True), []

    def residuals(x, shift):
        seen.append(shift)
        return x + 1e3 * shift

    loss = GaussNewton([x], shifts=4, damping=1e-9).step((lambda shift: residuals(x, shift)) if reads else residuals)
    assert float(loss) < 1e-6
    for coordinate in torch.stack(seen[:4]).T:  # each in a row and a column of its own
        torch.testing.assert_close(coordinate.sort()[0], torch.tensor([-0.375, -0.125, 0.125, 0.375]))


def test_shifts_reduce_the_noise_of_small_faces():
    """The columns' error falls with the root of the number of shifts: to a quarter for 16, less that of the truth."""
    vertices, faces = nr.icosphere(4)
    colors = torch.rand(len(faces), 1, 1, 1, 3, generator=torch.Generator().manual_seed(0))
    step, eye = torch.zeros(3), torch.tensor([0.4, 0.5, 2.7])

    def draw(step, shift=(0.0, 0.0), size=16):  # 3 faces in a pixel
        camera = nr.Camera.look_at(eye + step).shifted(shift, size)
        return nr.render((0.6 * vertices, faces, colors), camera, size, outputs=("rgb",)).rgb

    fine = Residuals(lambda step: pyramid(draw(step, size=256), 1, skip=4)[0] / 16, [step]).columns((step,))[1]
    errors = [
        float((Residuals(draw if count > 1 else lambda x: draw(x), [step], count).columns((step,))[1] - fine).norm())
        for count in (1, 16)
    ]
    assert errors[1] < 0.4 * errors[0], errors
