"""Simple functions of large tensors without torch's threads.

torch computes on more than 32,768 numbers with threads of OpenMP, which then spin for a while on the processors that
the next kernel needs. Here NumPy computes on the threads of kernels. Small tensors, those on CUDA and those with
derivatives take torch's function.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from .launch import share
from .memory import DTYPES, empty, zeros
from .registration import is_plain, may_read_values, needs_gradient

FEW = 1 << 15  # most numbers that torch computes on one thread


def copy(tensor: Tensor) -> Tensor:
    """Make a contiguous copy of a float32 tensor."""
    # Not np.positive, which takes two to four times as long.
    plain = functools.partial(torch.clone, memory_format=torch.contiguous_format)
    return _computed(plain, lambda value, out: np.copyto(out, value), tensor)


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


def joined(tensors: Sequence[Tensor], dim: int) -> Tensor:
    """Concatenate tensors to a contiguous one, as `torch.cat`; differentiable."""
    total = sum(each.numel() for each in tensors)
    is_one_type = len({each.dtype for each in tensors}) == 1 and tensors[0].dtype in DTYPES
    if total <= FEW or not (is_one_type and are_for_numpy(*tensors)):
        return torch.cat([*tensors], dim)
    return _Joined.apply(dim, *tensors)  # type: ignore[no-untyped-call]


def in_pieces(function: Callable[..., Tensor], *tensors: Tensor, dim: int) -> Tensor:
    """Compute ``function(*tensors)`` of large tensors for a few items along ``dim`` at once; items are independent.

    torch computes each piece on one thread. Tensors with a single item go to all pieces.
    """
    if not are_for_numpy(*tensors):
        return function(*tensors)
    count = max(each.shape[dim] for each in tensors)
    most = max(map(len, tensors)) * max(each[:1].numel() // max(each.shape[dim], 1) for each in tensors)
    if count * most <= FEW:
        return function(*tensors)
    size = max(FEW // most, 1)
    size -= size % 64 if size > 64 else 0  # whole vectors, in which torch computes the same bits
    sizes = [min(size, count - first) for first in range(0, count, size)]
    pieces = (views(each, sizes, dim) if each.shape[dim] == count else (each,) * len(sizes) for each in tensors)
    return joined([function(*piece) for piece in zip(*pieces, strict=True)], dim)


def views(tensor: Tensor, sizes: Sequence[int], dim: int) -> tuple[Tensor, ...]:
    """Split a tensor as `torch.split`; differentiable."""
    if tensor.numel() <= FEW or not (are_for_numpy(tensor) and needs_gradient(tensor)):
        return tensor.split([*sizes], dim)
    return _Views.apply(tensor, sizes, dim)  # type: ignore[no-untyped-call]


def linear(tensor: Tensor, function: Callable[..., Any], transpose: Callable[..., Any]) -> Tensor:
    """Compute a linear function of arrays of a float32 tensor that NumPy can read; its transpose is its gradient."""
    return _Linear.apply(tensor, function, transpose)  # type: ignore[no-untyped-call]


class _Linear(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, tensor: Tensor, function: Callable[..., Any], transpose: Callable[..., Any]) -> Tensor:
        ctx.functions = transpose, function
        return torch.from_numpy(function(tensor.detach().numpy()))

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor, None, None]:
        return linear(grad, *ctx.functions), None, None


class _Joined(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, dim: int, *tensors: Tensor) -> Tensor:
        ctx.dim, ctx.sizes = dim, [each.shape[dim] for each in tensors]
        shape = [*tensors[0].shape]
        shape[dim] = sum(ctx.sizes)
        result = empty(shape, tensors[0].device, tensors[0].dtype)
        for place, each in zip(result.split(ctx.sizes, dim), tensors, strict=True):
            np.copyto(place.numpy(), each.detach().numpy())
        return result

    @staticmethod
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:
        if len(ctx.sizes) == 1:
            return None, grad
        pieces = zip(grad.split(ctx.sizes, ctx.dim), ctx.needs_input_grad[1:], strict=True)
        return None, *(joined((piece,), ctx.dim) if needed else None for piece, needed in pieces)


class _Views(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, tensor: Tensor, sizes: Sequence[int], dim: int) -> tuple[Tensor, ...]:
        ctx.set_materialize_grads(False)
        found = tensor.detach().split([*sizes], dim)
        ctx.dim, ctx.shapes = dim, [each.shape for each in found]
        return found

    @staticmethod
    def backward(ctx: Any, *grads: Tensor | None) -> tuple[Tensor, None, None]:
        device = next(grad.device for grad in grads if grad is not None)
        given = (zeros(shape, device) if grad is None else grad for grad, shape in zip(grads, ctx.shapes, strict=True))
        return joined([*given], ctx.dim), None, None


def apart(tensor: Any, uses: int) -> tuple[Any, ...]:
    """Return a tensor once for each of its uses; their gradients are summed from the last use to the first.

    What is not a tensor is returned as it is.
    """
    is_large = isinstance(tensor, Tensor) and tensor.numel() > FEW and tensor.dtype == torch.float32
    if not (is_large and are_for_numpy(tensor) and needs_gradient(tensor)):
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


def are_for_numpy(*tensors: Tensor) -> bool:
    """Test whether tensors are plain ones of the CPU, whose values may be read."""
    return tensors[0].is_cpu and is_plain(tensors) and may_read_values()


def _computed(plain: Callable[..., Tensor], by_numpy: Callable[..., Any], *tensors: Tensor) -> Tensor:
    """Compute ``plain(*tensors)``; ``by_numpy`` is the same for pieces of arrays, with the argument ``out``."""
    is_large = max(each.numel() for each in tensors) > FEW
    if not is_large or not are_for_numpy(*tensors) or needs_gradient(*tensors):
        return plain(*tensors)
    result = empty(tensors[0].shape, tensors[0].device)
    *given, target = (each.detach().numpy() for each in (*tensors, result))

    def compute(begin: int, end: int) -> None:
        by_numpy(*(each[begin:end] for each in given), out=target[begin:end])

    share(compute, len(target), least=1)
    return result
