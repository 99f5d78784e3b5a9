"""Gauss-Newton with Levenberg-Marquardt damping, for torch parameters.

Maths. Let r(x) be residuals, J their Jacobian and w the weights of a robust loss. The loss ½ Σ ρ(r²) is approximated by
½ |√w (r + J d)|² for a step d, whose minimum solves JᵀwJ d = −Jᵀw r. Damping adds λ D to the matrix, which shortens the
step and turns it towards the negative gradient (Marquardt, 1963). λ follows the ratio of the actual to the predicted
decrease (Nielsen, 1999; Madsen, Nielsen and Tingleff, "Methods for non-linear least squares problems", 2004, section
3.2).

Few parameters: J is computed column by column in forward mode, and D is the diagonal of JᵀwJ, which makes it invariant
to units. Many: conjugate gradients take only products with J and Jᵀ, and D is the curvature along the gradient. A
preconditioner P changes the variables, d = P u, so that steps are smooth if P smooths.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.func import jvp
from torch.optim import Optimizer

from ..base import validate
from . import conjugate_gradients
from .residuals import Residuals, Values, split
from .robust import LOSSES

_TRIALS = 6  # of a step, each with more damping
_LEAST_DAMPING, _MOST_DAMPING = 1e-9, 1e9
_TOLERANCE = 0.25  # relative residual at which conjugate gradients stop


class GaussNewton(Optimizer):
    """Gauss-Newton for residuals that are images: few steps, each of the cost of several steps of Adam.

    A step solves a linear least-squares problem and takes the solution if the loss falls; if not, it tries again with
    more damping. Linear problems, such as albedo under given light, need a single step.

    Poses, cameras and lights have few parameters. Then the closure should be a function of the parameters: forward mode
    computes all columns of the Jacobian in one pass. Vertices are many: the closure runs once for each product.

    Args:
        params: Parameters, or groups of them as for other optimisers. Options of a group: ``bounds``, a pair of numbers
            or tensors, low <= high, that broadcast to each parameter, or None; a start beyond is moved to the bound;
            ``preconditioner``, a symmetric positive linear function from a tensor of the parameter's shape to such a
            tensor, or None.
        damping: First value of λ, relative to the curvature, > 0. It adapts in each step, and returns to at most this
            after a step without a lower loss, as at a minimum: residuals may change between steps.
        loss: ``"squares"``; or a robust loss, for outliers such as occluders and highlights: ``"huber"``,
            ``"cauchy"`` or ``"geman_mcclure"``.
        scale: Residual above which the robust loss grows slower than the square, > 0.
        positions: Function of the parameters, in their order, that returns points whose motion in a step is limited:
            [..., 2] in pixels, such as ``lambda pose: camera_of(pose).project(points, size)[0]``. A derivative holds
            for small motions only.
        pixels: Largest motion of a position in a step, in pixels.
        most_columns: Up to so many parameters, the Jacobian is computed column by column.
        iterations: Largest number of conjugate gradients' iterations in a step.
        shifts: Number of sub-pixel shifts over which residuals and their derivatives are averaged, for meshes whose
            faces are smaller than a pixel: there the derivative of a single image is noisy. If more than 1, the closure
            has a keyword ``shift``, [2] pixels in (-1/2, 1/2), for `Camera.shifted`, and runs once for each.

    Raises:
        TypeError, ValueError: An argument has another type or is out of range, or a parameter is not floating.

    Example:
        >>> goal = nr.render(mesh, nr.Camera.look_at((0.0, 0.0, 2.2)), 32).alpha
        >>> eye = torch.tensor([0.0, 0.0, 2.7])
        >>> def residuals(eye):
        ...     return nr.optim.pyramid(nr.render(mesh, nr.Camera.look_at(eye), 32).alpha - goal, levels=4)
        >>> optimizer = nr.optim.GaussNewton([eye])
        >>> losses = [optimizer.step(residuals).item() for _ in range(6)]
        >>> abs(float(eye.norm()) - 2.2) < 0.02
        True
    """

    def __init__(
        self,
        params: Iterable[Any],
        *,
        damping: float = 1e-3,
        loss: str = "squares",
        scale: float = 0.1,
        positions: Callable[..., Tensor] | None = None,
        pixels: float = 8.0,
        most_columns: int = 64,
        iterations: int = 30,
        shifts: int = 1,
    ) -> None:
        if loss not in LOSSES:
            raise ValueError(f"loss: expected one of {', '.join(LOSSES)}, got {loss!r}")
        self._damping, self._scale, self._pixels = (
            validate.positive(name, value)
            for name, value in {"damping": damping, "scale": scale, "pixels": pixels}.items()
        )
        self._loss, self._positions = LOSSES[loss], _function("positions", positions)
        self._most_columns = validate.whole("most_columns", most_columns, 0)
        self._iterations, self._shifts = (
            validate.whole("iterations", iterations, 1),
            validate.whole("shifts", shifts, 1),
        )
        super().__init__(params, {"bounds": None, "preconditioner": None})
        self._state.update(damping=self._damping, growth=2.0)

    def add_param_group(self, param_group: dict[str, Any]) -> None:
        """Add parameters, such as those of a later stage; the closure takes them after the others.

        Args:
            param_group: ``params`` and their options, as in the constructor.

        Raises:
            TypeError, ValueError: As the constructor.
        """
        for name in set(param_group) - {"params", *self.defaults} if isinstance(param_group, dict) else ():
            raise ValueError(f"params: expected options of a group among {', '.join(self.defaults)}, got {name!r}")
        super().add_param_group(param_group)
        group = self.param_groups[-1]
        for index, each in enumerate(group["params"]):
            validate.floating(f"params[{index}]", each, tuple(each.shape))
            if not each.numel():
                raise ValueError(f"params[{index}]: expected at least one number, got {validate.shape_of(each)}")
        _function("preconditioner", group["preconditioner"])
        if group["bounds"] is not None:
            _check_bounds(group["bounds"], group["params"])

    def step(self, closure: Callable[..., Any]) -> Tensor:  # type: ignore[override]
        """Take a step.

        Args:
            closure: Function that returns residuals: a floating tensor, or several, of any shapes. It is a function of
                the parameters, in their order. Or it has no arguments without defaults, and reads the parameters, which
                must then require gradients; each column takes a separate pass.

        Returns:
            The loss after the step, []: ½ Σ ρ(r²), where ρ(r²) is r² for ``"squares"``, and about r² for small
            residuals of the robust losses. The step is 0 if no step lowers the loss, as at a minimum.

        Raises:
            TypeError: Residuals that are not floating tensors, or a closure that calls ``backward``.
            ValueError: Residuals, derivatives or motions of positions that are not finite, or no residuals that depend
                on the parameters.

        Example:
            >>> x = torch.zeros(2)
            >>> loss = nr.optim.GaussNewton([x]).step(lambda x: x - torch.tensor([1.0, 2.0]))
        """
        parameters = self._options("params")
        problem = Residuals(closure, parameters, self._shifts)
        values = best = self._bounded(each.detach().clone() for each in parameters)
        try:
            few = sum(value.numel() for value in values) <= self._most_columns
            model = (self._of_columns if few else self._of_products)(problem, values)
            loss, start = model.loss, self._state["damping"]
            for _ in range(_TRIALS if bool(model.gradient.any()) else 0):
                step = model.solve(self._state["damping"])
                if bool(-(model.gradient * step).sum() <= torch.finfo(loss.dtype).eps * loss):
                    self._state["growth"] = 2.0
                    break  # the decrease is below the loss's precision, and more damping makes it smaller
                found = self._moved(values, step)
                after = self._cost(problem.at(found))[0]
                predicted = loss - model.predicted(_flat(found) - _flat(values))
                ratio = float((loss - after) / predicted) if predicted > 0 else -1.0
                if self._adapt(ratio if math.isfinite(ratio) else -1.0):
                    best, loss = found, after
                    break
            if best is values:
                self._start_anew(start)
        finally:
            problem.set(best)
        return loss

    def _of_columns(self, problem: Residuals, values: Values) -> _Model:
        residuals, jacobian = problem.columns(values)
        if not bool(jacobian.any()):
            problem.products(values)[2](residuals)  # raises unless residuals depend on the parameters
        loss, weights = self._cost(residuals)
        gradient = jacobian.T @ (weights * residuals)
        free = self._free(values, gradient)
        matrix = ((jacobian.T * weights) @ jacobian).double() * free[:, None] * free
        scales = matrix.diagonal().clamp(min=1e-12 * float(matrix.diagonal().amax()) + 1e-300)

        def solve(damping: float) -> Tensor:
            damped = matrix + torch.diag(damping * scales + (free == 0))
            return torch.linalg.solve(damped, -(gradient * free).double()).to(gradient)

        def curvature(step: Tensor) -> Tensor:
            return step.double() @ matrix @ step.double()

        return _Model(loss, gradient * free, solve, curvature)

    def _of_products(self, problem: Residuals, values: Values) -> _Model:
        residuals, jvp, vjp = problem.products(values)
        loss, weights = self._cost(residuals)
        gradient = vjp(weights * residuals)
        free = self._free(values, gradient)

        def smooth(vector: Tensor) -> Tensor:
            return self._preconditioned(vector, values)

        def normal(u: Tensor) -> Tensor:
            return smooth(free * vjp(weights * jvp(free * smooth(u))))

        down = -smooth(free * gradient)
        along = jvp(free * smooth(down))
        curvature_down = float((weights * along * along).sum() / down.square().sum().clamp(min=1e-30))

        def solve(damping: float) -> Tensor:
            shift = damping * curvature_down

            def damped(u: Tensor) -> Tensor:
                return (normal(u[:, 0]) + shift * u[:, 0])[:, None]

            found = conjugate_gradients.solve(damped, down[:, None], iterations=self._iterations, tolerance=_TOLERANCE)
            return free * smooth(found[:, 0])

        def curvature(step: Tensor) -> Tensor:
            change = jvp(step)
            return (weights * change * change).sum()

        return _Model(loss, gradient * free, solve, curvature)

    def _moved(self, values: Values, step: Tensor) -> Values:
        """Take a step, shortened to the trust region, and keep the parameters within their bounds."""
        if self._positions is not None:
            with torch.no_grad():
                motion = jvp(self._positions, values, split(step, values))[1]
            farthest = float(torch.linalg.vector_norm(motion, dim=-1).amax()) if motion.numel() else 0.0
            if not math.isfinite(farthest):
                raise ValueError("positions: expected finite motions of points, got NaN or infinity")
            step = step * min(1.0, self._pixels / max(farthest, 1e-30))
        return self._bounded(value + part for value, part in zip(values, split(step, values), strict=True))

    def _bounded(self, values: Iterable[Tensor]) -> Values:
        return tuple(
            value if bounds is None else torch.clamp(value, *(torch.as_tensor(b).to(value) for b in bounds))
            for value, bounds in zip(values, self._options("bounds"), strict=True)
        )

    def _free(self, values: Values, gradient: Tensor) -> Tensor:
        """Find the parameters that the step may change, [P] of 1 and 0: those without an active bound."""
        parts = []
        for value, slope, bounds in zip(values, split(gradient, values), self._options("bounds"), strict=True):
            held = torch.zeros_like(value, dtype=torch.bool)
            if bounds is not None:
                low, high = (torch.as_tensor(bound).to(value) for bound in bounds)
                held = ((value <= low) & (slope > 0)) | ((value >= high) & (slope < 0))
            parts.append((~held).to(value).flatten())
        return torch.cat(parts)

    def _preconditioned(self, vector: Tensor, values: Values) -> Tensor:
        parts = zip(split(vector, values), self._options("preconditioner"), strict=True)
        return torch.cat([(part if function is None else function(part)).flatten() for part, function in parts])

    def _cost(self, residuals: Tensor) -> tuple[Tensor, Tensor]:
        """Compute the loss, [], and the weights of the residuals, [N]."""
        rho, weights = self._loss((residuals / self._scale).square())
        loss = 0.5 * self._scale**2 * rho.double().sum()
        return loss.to(residuals), weights

    def _adapt(self, ratio: float) -> bool:
        """Adapt the damping to the actual decrease over the predicted one; return whether to take the step."""
        state = self._state
        if ratio > 0:
            state["damping"] *= max(1 / 3, 1 - (2 * min(ratio, 1.0) - 1) ** 3)
            state["growth"] = 2.0
        else:
            state["damping"] *= state["growth"]
            state["growth"] *= 2.0
        state["damping"] = min(max(state["damping"], _LEAST_DAMPING), _MOST_DAMPING)
        return ratio > 0

    def _start_anew(self, damping: float) -> None:
        """Reset the damping after a step whose trials failed, unless it was lower, because the problem may change.

        Growth is kept, so that the next step tries more damping than this one, up to the maximum.
        """
        state = self._state
        if state["damping"] == _MOST_DAMPING:
            state["growth"] = 2.0
        state["damping"] = min(damping, self._damping)

    @property
    def _state(self) -> dict[str, Any]:
        return self.state[self.param_groups[0]["params"][0]]

    def _options(self, name: str) -> list[Any]:
        """Return an option of each parameter, or with "params" the parameters."""
        pairs = ((group, each) for group in self.param_groups for each in group["params"])
        return [each if name == "params" else group[name] for group, each in pairs]


@dataclass(frozen=True)
class _Model:
    """The quadratic model of the loss around the parameters."""

    loss: Tensor
    gradient: Tensor  # [P], 0 where a bound is active
    solve: Callable[[float], Tensor]  # from the damping to a step, [P]
    curvature: Callable[[Tensor], Tensor]  # from a step d to dᵀ M d

    def __post_init__(self) -> None:
        if not bool(self.loss.isfinite() & self.gradient.isfinite().all()):
            raise ValueError("closure: expected finite residuals and derivatives, got NaN or infinity")

    def predicted(self, step: Tensor) -> Tensor:
        return self.loss + (self.gradient * step).sum() + 0.5 * self.curvature(step).to(self.loss)


def _function(name: str, value: Any) -> Any:
    """Return ``value`` if it is a function or None; raise TypeError otherwise."""
    if value is None or callable(value):
        return value
    raise TypeError(f"{name}: expected a function or None, got {type(value).__name__}")


def _check_bounds(bounds: Any, parameters: list[Tensor]) -> None:
    """Raise ValueError unless the bounds are a pair that fits the parameters, the low one first."""
    try:
        low, high = (torch.as_tensor(bound) for bound in bounds)
        shapes = [each.shape for each in parameters]
        fits = bool((low <= high).all()) and all(
            torch.broadcast_shapes(low.shape, high.shape, shape) == shape for shape in shapes
        )
    except (TypeError, ValueError, RuntimeError):
        fits = False
    if not fits:
        wanted = "a pair (low, high) of numbers or tensors, low <= high, that broadcast to each parameter"
        raise ValueError(f"bounds: expected {wanted}, got {bounds!r}")


def _flat(values: Values) -> Tensor:
    return torch.cat([value.flatten() for value in values])
