"""Residuals as a function of parameters, and products with their Jacobian in forward and reverse mode."""

from __future__ import annotations

import functools
import inspect
import math
import operator
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.autograd import forward_ad
from torch.func import jacfwd, jvp

Values = tuple[Tensor, ...]
Product = Callable[[Tensor], Tensor]


class Residuals:
    """A closure of residuals, and its parameters.

    Args:
        closure: Function of the parameters, in their order; or one without arguments that reads them. Returns a tensor
            or several, of any shapes.
        parameters: The tensors.
        shifts: Number of sub-pixel shifts over which residuals are averaged; if more than 1, the closure takes one as
            ``shift``, [2].
    """

    def __init__(self, closure: Callable[..., Any], parameters: Sequence[Tensor], shifts: int = 1) -> None:
        self._closure, self._parameters = closure, parameters
        at = sub_pixel_shifts(shifts).to(parameters[0])
        self._shifts: list[dict[str, Tensor]] = [{"shift": each} for each in at] if shifts > 1 else [{}]
        accepted = inspect.signature(closure).parameters.values()
        if shifts > 1 and not any(each.name == "shift" or each.kind is each.VAR_KEYWORD for each in accepted):
            raise TypeError(f"closure: expected an argument shift, as shifts is {shifts}, got none")
        given = [
            each for each in accepted if each.name not in self._shifts[0]
        ]  # arguments with defaults are left to the caller
        self._reads = all(each.default is not each.empty or each.kind is each.VAR_KEYWORD for each in given)

    def at(self, values: Values) -> Tensor:
        """Compute the residuals, [N], without gradients."""
        with torch.no_grad():
            return self._compute(*values)

    def columns(self, values: Values) -> tuple[Tensor, Tensor]:
        """Compute the residuals, [N], and their Jacobian, [N, P], column by column."""
        if self._reads:  # one pass per column
            sizes = [value.numel() for value in values]
            units = torch.eye(sum(sizes), dtype=values[0].dtype, device=values[0].device)
            columns = [self._jvp_in_place(values, split(unit, values)) for unit in units]
            return self.at(values), torch.stack(columns, 1)

        def with_value(*given: Tensor) -> tuple[Tensor, Tensor]:
            found = self._compute(*given)
            return found, found

        with torch.no_grad():
            parts, residuals = jacfwd(with_value, tuple(range(len(values))), has_aux=True)(*values)
        return residuals, torch.cat([part.reshape(len(residuals), -1) for part in parts], 1)

    def products(self, values: Values) -> tuple[Tensor, Product, Product]:
        """Return the residuals r [N] and two functions of their Jacobian J: v ↦ J v and w ↦ Jᵀ w.

        v [P] has the parameters one after the other.
        """
        if self._reads:
            jvp_in_place, vjp_in_place = self._jvp_in_place, self._vjp_in_place
            return self.at(values), lambda v: jvp_in_place(values, split(v, values)), lambda w: vjp_in_place(values, w)
        leaves = tuple(value.detach().clone().requires_grad_() for value in values)
        with torch.enable_grad():
            residuals = self._compute(*leaves)

        def change(v: Tensor) -> Tensor:
            with torch.no_grad():
                found: Tensor = jvp(self._compute, values, split(v, values))[1]
            return found

        return residuals.detach(), change, lambda w: _gradient(residuals, leaves, w)

    def set(self, values: Values) -> None:
        """Change the parameters, and their tangents if the values have some, in place."""
        with torch.no_grad():
            for parameter, value in zip(self._parameters, values, strict=True):
                parameter.copy_(value)

    def _compute(self, *values: Tensor) -> Tensor:
        if self._reads:
            self.set(values)
        arguments = () if self._reads else values
        try:
            found = [_joined(self._closure(*arguments, **shift)) for shift in self._shifts]
        except RuntimeError as error:
            if self._reads and "does not require grad" in str(error):  # the first call is under no_grad
                wanted = "a function that returns residuals and leaves derivatives to the optimiser"
                raise TypeError(f"closure: expected {wanted}, got one that calls backward() or grad()") from error
            raise
        return functools.reduce(operator.add, found) / len(found)

    def _jvp_in_place(self, values: Values, direction: Values) -> Tensor:
        with torch.no_grad(), forward_ad.dual_level():
            found = self._compute(*map(forward_ad.make_dual, values, direction))
            residuals, change = forward_ad.unpack_dual(found)
            return torch.zeros_like(residuals) if change is None else change

    def _vjp_in_place(self, values: Values, weights: Tensor) -> Tensor:
        with torch.enable_grad():
            return _gradient(self._compute(*values), tuple(self._parameters), weights)


def sub_pixel_shifts(count: int) -> Tensor:
    """Make a lattice of points [count, 2] around a pixel's centre, each in a different row and column."""
    modulus = count + 1
    step = next(step for step in range(round(modulus / 1.618), modulus + 1) if math.gcd(step, modulus) == 1)
    rows = torch.arange(1, modulus)
    return (torch.stack((rows, rows * step % modulus), 1) - modulus / 2) / count


def _gradient(residuals: Tensor, leaves: Values, weights: Tensor) -> Tensor:
    """Compute Jᵀ w, [P]; the graph is kept."""
    if not residuals.requires_grad:
        got = "torch.inference_mode, which does not record them" if torch.is_inference_mode_enabled() else "others"
        raise ValueError(f"closure: expected residuals that depend on the parameters, got {got}")
    found = torch.autograd.grad(residuals, leaves, weights, retain_graph=True, allow_unused=True)
    both = zip(found, leaves, strict=True)
    return torch.cat([(torch.zeros_like(v) if grad is None else grad).flatten() for grad, v in both])


def split(vector: Tensor, values: Values) -> Values:
    """Split a flat vector [P] into tensors shaped like ``values``."""
    parts = vector.split([value.numel() for value in values])
    return tuple(part.view_as(value) for part, value in zip(parts, values, strict=True))


def _joined(found: Any) -> Tensor:
    several = isinstance(found, (tuple, list))
    parts = tuple(found) if several else (found,)
    if not parts or not all(isinstance(part, Tensor) and part.is_floating_point() for part in parts):
        raise TypeError(f"closure: expected a floating tensor of residuals or several, got {type(found).__name__}")
    joined = torch.cat([part.flatten() for part in parts])
    if not len(joined):
        raise ValueError("closure: expected residuals, got empty tensors")
    return joined
