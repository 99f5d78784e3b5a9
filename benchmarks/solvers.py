"""Gauss-Newton beside Adam and L-BFGS: steps and seconds to the same loss, ``python -m benchmarks.solvers``.

Each problem starts from a wrong guess; residuals are pyramids of the difference of images. A solver has reached the
goal when the loss is a given part of its value at the start. Adam's rate is the best of three for each problem, found
by running all of them; L-BFGS has torch's strong Wolfe line search. Seconds are processor time on one thread.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

import neural_renderer as nr

_RATES = (0.1, 0.03, 0.01)
_MOST_SECONDS = 8.0


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
    """Make the problems: a pose, a camera, light and albedo, and vertices."""
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

    goal_pose, goal_eye = torch.tensor([0.2, -0.25, 0.15, 0.08, -0.06, 0.1]), torch.tensor([0.4, 0.5, 2.7])
    target_pose, target_eye = posed(goal_pose), seen(goal_eye, torch.tensor(20.0))
    target_lit = lit(cubes)
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


def _run(problem: Problem, step: Callable[[], Tensor], goal: float, most: int) -> tuple[int, float] | None:
    """Step until the loss is at the goal; return the steps and seconds, or None."""
    begin = time.process_time()
    for n in range(1, most + 1):
        if float(step().detach()) <= goal:
            return n, time.process_time() - begin
        if time.process_time() - begin > _MOST_SECONDS:
            break
    return None


def solve(problem: Problem, solver: str, rate: float = 0.1, most: int = 1000) -> tuple[int, float] | None:
    """Run "gauss-newton", "adam" or "l-bfgs"; return the steps and seconds to the goal, or None if it is not reached.

    Steps of L-BFGS are runs of the closure.
    """
    own = [each.clone().requires_grad_() for each in problem.start]
    goal = problem.goal * float(problem.loss(*problem.start))
    options = problem.options or ({},) * len(own)
    if solver == "gauss-newton":
        groups = [{"params": [each], **option} for each, option in zip(own, options, strict=True)]
        optimizer = nr.optim.GaussNewton(groups)
        return _run(problem, lambda: optimizer.step(problem.residuals), goal, 100)
    smooth = [option.get("preconditioner") for option in options]
    if smooth[0] is None:
        variables, place = own, lambda: own
    else:  # the same change of variables
        variables = [torch.zeros_like(each).requires_grad_() for each in own]
        place = lambda: [x.detach() + s(u) for x, u, s in zip(own, variables, smooth, strict=True)]  # noqa: E731
    adam = torch.optim.Adam(variables, rate)
    lbfgs = torch.optim.LBFGS(variables, 1.0, max_iter=1, max_eval=20, line_search_fn="strong_wolfe")
    runs = 0

    def closure() -> Tensor:
        nonlocal runs
        runs += 1
        for each in variables:
            each.grad = None
        loss = problem.loss(*place())
        loss.backward()
        return loss

    optimizer = adam if solver == "adam" else lbfgs
    found = _run(problem, lambda: optimizer.step(closure), goal, most)
    return None if found is None else (runs, found[1])


def main() -> None:
    """Print the table."""
    torch.set_num_threads(1)
    print("| problem | Gauss–Newton | Adam | L-BFGS |\n|---|---|---|---|")
    for problem in problems():
        for _ in range(2):  # the first run compiles
            newton = solve(problem, "gauss-newton")
        adam = [solve(problem, "adam", rate) for rate in _RATES]
        best = min((found for found in adam if found), key=lambda found: found[1], default=None)
        cells = (newton, best, solve(problem, "l-bfgs"))
        row = " | ".join("not reached" if each is None else f"{each[0]} steps, {each[1]:.2f} s" for each in cells)
        print(f"| {problem.name} | {row} |", flush=True)


if __name__ == "__main__":
    main()
