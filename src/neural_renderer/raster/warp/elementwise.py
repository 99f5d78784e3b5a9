"""Simple functions of large tensors without torch's threads.

torch computes on more than 32,768 numbers with threads of OpenMP, which then spin for a while on the processors that
the next kernel needs. Here NumPy computes on the threads of kernels. Small tensors, those on CUDA and those with
derivatives take torch's function.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .launch import share
from .memory import empty
from .registration import is_plain, needs_gradient

FEW = 1 << 15  # most numbers that torch computes on one thread


def copy(tensor: Tensor) -> Tensor:
    """Make a contiguous copy of a float32 tensor."""
    return _computed(lambda value: value.clone(memory_format=torch.contiguous_format), np.positive, tensor)


def quarter(tensor: Tensor) -> Tensor:
    """Multiply a float32 tensor by 1 / 4."""
    return _computed(lambda value: 0.25 * value, functools.partial(np.multiply, np.float32(0.25)), tensor)


def equal(one: Tensor, other: Tensor) -> bool:
    """Test whether two tensors of integers or floats have the same shape and numbers, as `torch.equal`."""
    if one.numel() <= FEW or not (one.is_cpu and other.is_cpu):
        return torch.equal(one, other)
    return np.array_equal(np.from_dlpack(one.detach()), np.from_dlpack(other.detach()))


def any_of(tensor: Tensor) -> bool:
    """Test whether a tensor has a number other than 0; waits for its device."""
    large = tensor.is_cpu and tensor.numel() > FEW
    return bool(np.any(np.from_dlpack(tensor.detach())) if large else tensor.any())


def apart(tensor: Any, uses: int) -> tuple[Any, ...]:
    """Return a tensor once for each of its uses; their gradients are summed from the last use to the first.

    What is not a tensor is returned as it is.
    """
    if not isinstance(tensor, Tensor) or tensor.numel() <= FEW or not tensor.is_cpu or tensor.dtype != torch.float32:
        return (tensor,) * uses
    if not (tensor.requires_grad and torch.is_grad_enabled() and is_plain((tensor,))):
        return (tensor,) * uses
    return _Apart.apply(tensor, uses)  # type: ignore[no-untyped-call]


class _Apart(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, tensor: Tensor, uses: int) -> tuple[Tensor, ...]:
        ctx.set_materialize_grads(False)
        return tuple(tensor.detach() for _ in range(uses))

    @staticmethod
    def backward(ctx: Any, *grads: Tensor | None) -> tuple[Tensor | None, None]:
        found = [grad for grad in reversed(grads) if grad is not None]
        return functools.reduce(lambda one, other: _computed(torch.add, np.add, one, other), found), None


def _is_for_numpy(*tensors: Tensor) -> bool:
    """Test whether a tensor is large, and NumPy can read all: plain tensors of the CPU without derivatives."""
    is_large = max(each.numel() for each in tensors) > FEW
    return is_large and is_plain(tensors) and tensors[0].is_cpu and not needs_gradient(*tensors)


def _computed(plain: Callable[..., Tensor], by_numpy: Callable[..., Any], *tensors: Tensor) -> Tensor:
    """Compute ``plain(*tensors)``; ``by_numpy`` is the same for pieces of arrays, with the argument ``out``."""
    if not _is_for_numpy(*tensors):
        return plain(*tensors)
    result = empty(tensors[0].shape, tensors[0].device)
    *given, target = (each.detach().numpy() for each in (*tensors, result))

    def compute(begin: int, end: int) -> None:
        by_numpy(*(each[begin:end] for each in given), out=target[begin:end])

    share(compute, len(target), least=1)
    return result
