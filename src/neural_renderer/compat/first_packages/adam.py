"""Adam of the published `neural_renderer`, for sparse gradients in dense tensors."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from inspect import unwrap
from typing import Any

import torch
from torch import Tensor

from ...base import validate

_PIECE = 1 << 16  # elements updated together, so that they fit into a processor's cache


class _Optimizer(torch.optim.Optimizer):
    """torch's optimiser without the decorator of its methods, which imports torch's compiler: a second per process."""

    add_param_group = unwrap(torch.optim.Optimizer.add_param_group)
    zero_grad = unwrap(torch.optim.Optimizer.zero_grad)
    state_dict = unwrap(torch.optim.Optimizer.state_dict)
    load_state_dict = unwrap(torch.optim.Optimizer.load_state_dict)


class Adam(_Optimizer):
    """Adam that skips elements with a gradient of exactly 0, such as vertices and texels that no image shows.

    Parameters and running means of these elements do not change. The other elements follow Adam (Kingma and Ba, 2015):
    m += (1 − β1)(g − m), v += (1 − β2)(g² − v), p −= lr · √(1 − β2ᵗ) / (1 − β1ᵗ) · m / (√v + eps). As in Chainer, t
    counts the calls of `step` for the whole group; it is stored in ``param_groups[i]["step"]``. Steps of float16 and
    bfloat16 parameters are computed in float32.

    The learning rate of a parameter is multiplied by its attribute ``lr``, if it has one: ``mesh.vertices.lr = 0.01``.
    This attribute belongs to the tensor and is not part of the `state_dict`.

    Args:
        params: Parameters, named parameters or parameter groups, as for any torch optimiser.
        lr: Learning rate α, ≥ 0.
        betas: Decay rates (β1, β2), each in [0, 1).
        eps: Number added to √v, > 0.
        alpha, beta1, beta2: Chainer's names of ``lr`` and the two ``betas``; they take precedence.

    Raises:
        TypeError, ValueError: A number is out of range; in `step`, a gradient is sparse or complex.

    Example:
        >>> mesh = nr.Mesh.icosphere(2).trainable()
        >>> optimizer = nr.Adam([mesh.vertices], lr=0.01)
        >>> optimizer.add_param_group({"params": [mesh.textures], "lr": 0.1})
        >>> nr.render(mesh, camera, 64).alpha.mean().backward()
        >>> optimizer.step()
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
        """Add a parameter group, as for any torch optimiser. Its t starts at 0.

        Args:
            param_group: "params", and optionally "lr", "betas" and "eps" for these parameters.

        Raises:
            TypeError, ValueError: A number is out of range.
        """
        options = {**self.defaults, **param_group}
        if validate.number("lr", options["lr"]) < 0:
            raise ValueError(f"lr: expected a number of at least 0, got {options['lr']}")
        if validate.number("eps", options["eps"]) <= 0:  # a skipped element computes 0 / (√v + eps) with v = 0
            raise ValueError(f"eps: expected a positive number, got {options['eps']}")
        for name, beta in zip(("beta1", "beta2"), _pair(options["betas"]), strict=True):
            if not 0 <= validate.number(name, beta) < 1:
                raise ValueError(f"{name}: expected a number in [0, 1), got {beta}")
        super().add_param_group(param_group)

    @torch.no_grad()
    def step(self, closure: Callable[[], Any] | None = None) -> Any:
        """Update the parameters once.

        Args:
            closure: Function that computes the gradients and returns the loss; it is called first.

        Returns:
            The result of ``closure``, or None.

        Raises:
            TypeError: A gradient is sparse or complex.
        """
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
        # In pieces, so that intermediate results stay in the processor's caches.
        rows = max(1, _PIECE * len(parameter) // parameter.numel())
        parts = (t.split(rows) for t in (parameter, gradient, state["m"], state["v"]))
        for part, slope, m, v in zip(*parts, strict=True):
            _move(part, slope, m, v, rates)

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Restore the result of `state_dict`, as for any torch optimiser."""
        super().load_state_dict(state_dict)
        # torch casts the means to the parameters' dtype, which may lack range and precision.
        numbers = (number for group in state_dict["param_groups"] for number in group["params"])
        parameters = (parameter for group in self.param_groups for parameter in group["params"])
        for number, parameter in zip(numbers, parameters, strict=True):
            for name, mean in state_dict["state"].get(number, {}).items():
                self.state[parameter][name] = mean.to(parameter.device, _at_least_float32(parameter.dtype), copy=True)


def _move(parameter: Tensor, gradient: Tensor, m: Tensor, v: Tensor, rates: tuple[float, float, float, float]) -> None:
    """Take one step, in place."""
    rate, beta1, beta2, eps = rates
    gradient = gradient.to(m.dtype)
    live = (gradient != 0).to(m.dtype)  # a weight of 0 skips an element
    m.lerp_(gradient, live * (1 - beta1))
    v.lerp_(gradient * gradient, live * (1 - beta2))
    parameter.copy_(parameter.to(m.dtype).addcdiv_(live * m, v.sqrt().add_(eps), value=-rate))


def _at_least_float32(dtype: torch.dtype) -> torch.dtype:
    """Return the dtype of the running means. 16-bit floats cannot hold squared gradients and eps."""
    return torch.promote_types(dtype, torch.float32)


def _pair(betas: Any) -> tuple[Any, Any]:
    """Return the two numbers of ``betas``; raise ValueError if there are not two."""
    if not isinstance(betas, (tuple, list)) or len(betas) != 2:
        raise ValueError(f"betas: expected two numbers, got {betas!r}")
    return betas[0], betas[1]
