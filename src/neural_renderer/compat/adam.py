"""The Adam of the published `neural_renderer`, made for gradients that are exactly zero almost everywhere."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import Any

import torch
from torch import Tensor

from .. import validate

_PIECE = 1 << 16  # elements


class Adam(torch.optim.Optimizer):
    """Adam that leaves alone what got no gradient.

    A texture's texels and a mesh's vertices that no image of this step shows have a gradient of exactly 0. For those
    elements the running means and the parameter stay as they are; the others follow Adam (Kingma and Ba, 2015):
    m += (1 − β1)(g − m), v += (1 − β2)(g² − v), p −= lr · √(1 − β2ᵗ) / (1 − β1ᵗ) · m / (√v + eps). t counts the calls
    of `step` for the whole group, as in Chainer, and is kept in ``param_groups[i]["step"]``. Half and bfloat16
    parameters are moved by steps computed in float32.

    The rate of a single parameter is multiplied by its attribute ``lr``, if it has one: ``mesh.vertices.lr = 0.01``.
    That attribute belongs to the tensor, so it is not part of the `state_dict`.

    Args:
        params: parameters, named parameters, or parameter groups, as for any torch optimiser.
        lr: the rate α, ≥ 0.
        betas: (β1, β2), each in [0, 1).
        eps: added to √v, > 0.
        alpha, beta1, beta2: Chainer's names for ``lr`` and ``betas``; where given they win.

    Raises:
        TypeError, ValueError: numbers out of these ranges; in `step`, a sparse or complex gradient.
    """

    def __init__(
        self,
        params: Iterable[Any],
        lr: float = 1e-3,
        betas: tuple[float, float] = (0.9, 0.999),
        eps: float = 1e-8,
        *,
        alpha: float | None = None,
        beta1: float | None = None,
        beta2: float | None = None,
    ) -> None:
        first, second = _pair(betas)
        rates = (first if beta1 is None else beta1, second if beta2 is None else beta2)
        defaults = {"lr": lr if alpha is None else alpha, "betas": rates, "eps": eps, "step": 0}
        super().__init__(params, defaults)

    def add_param_group(self, param_group: dict[str, Any]) -> None:
        """Add parameters with their own rates, as for any torch optimiser; their t starts at 0."""
        options = {**self.defaults, **param_group}
        if validate.number("lr", options["lr"]) < 0:
            raise ValueError(f"lr: expected a number of at least 0, got {options['lr']}")
        if validate.number("eps", options["eps"]) <= 0:  # an untouched element has m / (√v + eps) = 0 / eps
            raise ValueError(f"eps: expected a positive number, got {options['eps']}")
        for name, beta in zip(("beta1", "beta2"), _pair(options["betas"]), strict=True):
            if not 0 <= validate.number(name, beta) < 1:
                raise ValueError(f"{name}: expected a number in [0, 1), got {beta}")
        super().add_param_group(param_group)

    @torch.no_grad()
    def step(self, closure: Callable[[], Any] | None = None) -> Any:
        """Update the parameters once; returns what ``closure``, which is called first with gradients on, returns."""
        loss = None
        if closure is not None:
            with torch.enable_grad():
                loss = closure()
        for group in self.param_groups:
            group["step"] += 1
            beta1, beta2 = group["betas"]
            rate = group["lr"] * math.sqrt(1 - beta2 ** group["step"]) / (1 - beta1 ** group["step"])
            for parameter in group["params"]:
                if parameter.grad is not None:
                    self._update(parameter, rate * getattr(parameter, "lr", 1.0), beta1, beta2, group["eps"])
        return loss

    def _update(self, parameter: Tensor, rate: float, beta1: float, beta2: float, eps: float) -> None:
        gradient = parameter.grad
        if gradient is None or gradient.is_sparse or gradient.is_complex():
            raise TypeError("gradient: expected a dense real tensor, got a sparse or complex one")
        wide = _at_least_float32(parameter.dtype)
        state = self.state[parameter]
        if not state:
            state["m"], state["v"] = (torch.zeros_like(parameter, dtype=wide) for _ in range(2))
        rates = rate, beta1, beta2, eps
        if parameter.device.type != "cpu" or parameter.numel() <= _PIECE:
            _move(parameter, gradient, state["m"], state["v"], rates)
            return
        # Piece by piece, so that what is computed on the way stays in the processor's caches.
        rows = max(1, _PIECE * len(parameter) // parameter.numel())
        parts = (t.split(rows) for t in (parameter, gradient, state["m"], state["v"]))
        for part, slope, m, v in zip(*parts, strict=True):
            _move(part, slope, m, v, rates)

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore what `state_dict` returned, as for any torch optimiser."""
        super().load_state_dict(state_dict)
        # torch has cast the means to the parameters' dtype, which may not hold them.
        numbers = (number for group in state_dict["param_groups"] for number in group["params"])
        parameters = (parameter for group in self.param_groups for parameter in group["params"])
        for number, parameter in zip(numbers, parameters, strict=True):
            for name, mean in state_dict["state"].get(number, {}).items():
                self.state[parameter][name] = mean.to(parameter.device, _at_least_float32(parameter.dtype), copy=True)


def _move(parameter: Tensor, gradient: Tensor, m: Tensor, v: Tensor, rates: tuple[float, float, float, float]) -> None:
    """One step, in place."""
    rate, beta1, beta2, eps = rates
    gradient = gradient.to(m.dtype)
    live = (gradient != 0).to(m.dtype)  # as a weight: 0 leaves an element untouched
    m.lerp_(gradient, live * (1 - beta1))
    v.lerp_(gradient * gradient, live * (1 - beta2))
    parameter.copy_(parameter.to(m.dtype).addcdiv_(live * m, v.sqrt().add_(eps), value=-rate))


def _at_least_float32(dtype: torch.dtype) -> torch.dtype:
    """The dtype of the running means: half types hold neither squares of gradients nor eps."""
    return torch.promote_types(dtype, torch.float32)


def _pair(betas: Any) -> tuple[Any, Any]:
    if not isinstance(betas, (tuple, list)) or len(betas) != 2:
        raise ValueError(f"betas: expected two numbers, got {betas!r}")
    return betas[0], betas[1]
