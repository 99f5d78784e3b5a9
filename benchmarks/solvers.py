"""Gauss-Newton beside Adam and L-BFGS: steps and seconds to the same loss.

``python -m benchmarks.solvers [--plot docs/figures/solvers.png]`` (the figure needs matplotlib).

Each problem starts from a wrong guess; residuals are pyramids of the difference of images. A solver has reached the
goal when the loss is a given part of its value at the start. Adam's rate is the best of three for each problem, found
by running all of them; L-BFGS has torch's strong Wolfe line search. Seconds are processor time on one thread.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import Tensor

import neural_renderer as nr

_RATES = (0.1, 0.03, 0.01)
_MOST_SECONDS = 4.0


@dataclass(frozen=True)
class Problem:
    """Residuals of parameters, where to start, and the part of the first loss that is the goal."""

    name: str
    residuals: Callable[..., list[Tensor]]
    start: tuple[Tensor, ...]
    goal: float
    options: tuple[dict[str, object], ...] = ()

    def loss(self, *parameters: Tensor) -> Tensor:
        """Compute the loss of `nr.optim.GaussNewton`."""
        return torch.stack([0.5 * level.square().sum() for level in self.residuals(*parameters)]).sum()


def turned(vector: Tensor) -> Tensor:
    """Compute the rotation about a vector by its length, in radians."""
    x, y, z = vector
    zero = torch.zeros_like(x)
    cross = torch.stack((zero, -z, y, z, zero, -x, -y, x, zero)).view(3, 3)
    return torch.linalg.matrix_exp(cross)


def problems(size: int = 128) -> list[Problem]:
    """Make the problems: a pose, a camera, light, albedo, and vertices."""
    vertices, faces = nr.icosphere(3)
    bumps = 1 + 0.25 * torch.sin(3 * vertices[:, :1] + 1) * torch.cos(2 * vertices[:, 1:2])
    shape = 0.6 * vertices * bumps * torch.tensor([1.2, 0.9, 0.7])
    middle = vertices[faces.long()].mean(1)
    cubes = (0.6 + 0.3 * torch.sin(4 * middle + torch.tensor([0.0, 1, 2])))[:, None, None, None]
    camera = nr.Camera.look_at((0.4, 0.5, 2.7), viewing_angle=20)

    def draw(vertices: Tensor, cubes: Tensor = cubes, camera: nr.Camera = camera, **options: object) -> Tensor:
        return nr.render((vertices, faces, cubes), camera, size, outputs=("rgb",), **options).rgb

    def posed(pose: Tensor) -> Tensor:
        return draw(shape @ turned(pose[:3]).T + pose[3:])

    def seen(eye: Tensor, angle: Tensor) -> Tensor:
        return draw(shape, camera=nr.Camera.look_at(eye, viewing_angle=angle))

    def lit(cubes: Tensor) -> Tensor:
        return draw(shape, cubes, light=nr.Light(direction=(0.3, 0.8, 0.5)))

    def under(light: Tensor) -> Tensor:
        return draw(shape, light=nr.SphericalHarmonicLight(light))

    goal_pose, goal_eye = torch.tensor([0.2, -0.25, 0.15, 0.08, -0.06, 0.1]), torch.tensor([0.4, 0.5, 2.7])
    target_pose, target_eye = posed(goal_pose), seen(goal_eye, torch.tensor(20.0))
    target_lit = lit(cubes)
    uniform = torch.zeros(9, 3)
    uniform[0] = math.sqrt(4 * math.pi)
    bands = torch.linspace(0.4, -0.3, 9)[:, None] * torch.tensor([1.0, 0.8, 0.6])
    target_light = under(0.8 * uniform + bands)
    eyes = nr.get_points_from_angles(2.7, torch.tensor([20.0, -20, 20, -20]), torch.tensor([0.0, 90, 180, 270]))
    views = nr.Camera.look_at(eyes, viewing_angle=20)
    silhouettes = _silhouettes(shape, faces, views, size)
    smooth = _smoothing(faces, len(vertices))
    return [
        Problem("pose, 6 numbers", lambda p: nr.optim.pyramid(posed(p) - target_pose, 6), (torch.zeros(6),), 1e-3),
        Problem(
            "camera: position and viewing angle, 4 numbers",
            lambda e, a: nr.optim.pyramid(seen(e, a) - target_eye, 6),
            (torch.tensor([0.1, 0.1, 3.0]), torch.tensor(22.0)),
            1e-3,
        ),
        Problem("light: 27 spherical harmonics, linear", lambda c: [under(c) - target_light], (uniform,), 1e-3),
        Problem(
            "albedo of 1280 faces, linear",
            lambda c: [lit(c) - target_lit],
            (torch.full_like(cubes, 0.5),),
            1e-3,
            ({"bounds": (0.0, 1.0)},),
        ),
        Problem(
            "642 vertices, 4 silhouettes, smooth steps",
            lambda v: nr.optim.pyramid(_silhouettes(v, faces, views, size) - silhouettes, 4),
            (0.6 * vertices,),
            0.02,
            ({"preconditioner": smooth},),
        ),
    ]


def _silhouettes(vertices: Tensor, faces: Tensor, views: nr.Camera, size: int) -> Tensor:
    return nr.render((vertices, faces), views, size, outputs=("alpha",)).alpha


def _smoothing(faces: Tensor, count: int, strength: float = 10.0) -> Callable[[Tensor], Tensor]:
    """Make the map (1 + strength · Laplacian)⁻¹ of vertices, dense."""
    edges = torch.cat((faces[:, :2], faces[:, 1:], faces[:, ::2])).long()
    near = torch.zeros(count, count)
    near[edges[:, 0], edges[:, 1]] = near[edges[:, 1], edges[:, 0]] = 1.0
    inverse = torch.linalg.inv(torch.eye(count) + strength * (torch.diag(near.sum(1)) - near))
    return lambda vectors: inverse @ vectors


Curve = list[tuple[float, float]]  # seconds and loss, relative to the first one, after each run of the closure or step


def _run(step: Callable[[], Tensor], first: float, goal: float, most: int) -> Curve:
    """Step until the relative loss is at the goal."""
    begin = time.process_time()
    curve = [(0.0, 1.0)]
    while len(curve) <= most and curve[-1][0] < _MOST_SECONDS and curve[-1][1] > goal:
        loss = float(step().detach()) / first
        curve.append((time.process_time() - begin, loss))
    return curve


def solve(problem: Problem, solver: str, rate: float = 0.1, most: int = 1000) -> tuple[int, Curve]:
    """Run "gauss-newton", "adam" or "l-bfgs"; return the number of steps and the curve.

    Steps of L-BFGS are runs of the closure.
    """
    own = [each.clone().requires_grad_() for each in problem.start]
    first = float(problem.loss(*problem.start))
    options = problem.options or ({},) * len(own)
    if solver == "gauss-newton":
        groups = [{"params": [each], **option} for each, option in zip(own, options, strict=True)]
        newton = nr.optim.GaussNewton(groups)
        curve = _run(lambda: newton.step(problem.residuals), first, problem.goal, 100)
        return len(curve) - 1, curve
    smooth = [option.get("preconditioner") for option in options]
    if smooth[0] is None:
        variables, place = own, lambda: own
    else:  # the same change of variables
        variables = [torch.zeros_like(each).requires_grad_() for each in own]
        place = lambda: [x.detach() + s(u) for x, u, s in zip(own, variables, smooth, strict=True)]  # noqa: E731
    runs = 0

    def closure() -> Tensor:
        nonlocal runs
        runs += 1
        for each in variables:
            each.grad = None
        loss = problem.loss(*place())
        loss.backward()
        return loss

    optimizer = (
        torch.optim.Adam(variables, rate)
        if solver == "adam"
        else torch.optim.LBFGS(variables, 1.0, max_iter=1, max_eval=20, line_search_fn="strong_wolfe")
    )
    curve = _run(lambda: optimizer.step(closure), first, problem.goal, most)
    return runs, curve


def main() -> None:
    """Print the table, and draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plot", type=Path, help="draw the figure here, as PNG or SVG")
    options = parser.parse_args()
    torch.set_num_threads(1)
    rows = []
    print("| problem | Gauss–Newton | Adam | L-BFGS |\n|---|---|---|---|")
    for problem in problems():
        for _ in range(2):  # the first run compiles
            newton = solve(problem, "gauss-newton")
        tried = [solve(problem, "adam", rate) for rate in _RATES]
        adam = min(tried, key=lambda found: (max(found[1][-1][1], problem.goal), found[1][-1][0]))
        rows.append((problem, (newton, adam, solve(problem, "l-bfgs"))))
        cells = " | ".join(_cell(problem, *found) for found in rows[-1][1])
        print(f"| {problem.name} | {cells} |", flush=True)
    if options.plot:
        plot(rows, options.plot)


def _cell(problem: Problem, steps: int, curve: Curve) -> str:
    seconds, loss = curve[-1]
    if loss > problem.goal:
        return f"not reached in {_MOST_SECONDS:.0f} s"
    return f"{steps} {'step' if steps == 1 else 'steps'}, {seconds:.2f} s"


def plot(rows: list[tuple[Problem, tuple[tuple[int, Curve], ...]]], path: Path) -> None:
    """Plot the loss against seconds, for each problem."""
    import matplotlib.pyplot as plt

    figure, every = plt.subplots(1, len(rows), figsize=(3.4 * len(rows), 3.4))
    for axes, (problem, found) in zip(every, rows, strict=True):
        for name, (_, curve) in zip(("Gauss–Newton", "Adam", "L-BFGS"), found, strict=True):
            seconds, losses = zip(*curve, strict=True)
            axes.plot(seconds, losses, marker="o", markersize=3, label=name)
        axes.axhline(problem.goal, color="black", linewidth=0.8, zorder=0)
        axes.set(yscale="log", title=problem.name.split(":")[0].split(",")[0], xlabel="seconds")
        axes.grid(alpha=0.3)
    every[0].set_ylabel("loss ÷ first loss")
    every[0].legend(frameon=False)
    figure.tight_layout()
    figure.savefig(path, dpi=90)


if __name__ == "__main__":
    main()
