"""Conversion of camera and light parameters to tensors: one value for all views, or one for each view of a batch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
import torch
from torch import Tensor

from ..base import validate
from ..base.constants import constant

Scalar: TypeAlias = float | Tensor
"""A number, or a tensor [] or [B]: one number for each view."""
Array: TypeAlias = Tensor | np.ndarray | Sequence[Any]
"""Numbers as a tensor, an array or nested lists, with or without a leading batch dimension."""


def parameter(
    name: str,
    value: Any,
    size: tuple[int, ...],
    dtype: torch.dtype,
    device: torch.device | None = None,
    shared: bool = False,
) -> Tensor:
    """Convert numbers to a differentiable tensor of shape ``size`` or ``[B, *size]``, on a device if one is given.

    ``shared``: the caller only reads the result, so that a cached tensor may be returned for Python numbers.
    TypeError: The value holds no numbers. ValueError: The shape does not fit, or, while values are checked, a number is
    not finite.
    """
    if shared and device is not None and not isinstance(value, Tensor):
        known = constant(value, dtype, device)
        if known is not None and tuple(known.shape) == size:
            return known
    tensor = as_tensor(name, value, dtype)
    dims = tensor.ndim - len(size)
    if dims not in (0, 1) or tuple(tensor.shape[dims:]) != size:
        sizes = ", ".join(str(s) for s in size)
        batched = f"B, {sizes}" if size else "B"
        raise ValueError(f"{name}: expected shape [{sizes}] or [{batched}], got {validate.shape_of(tensor)}")
    if tensor.is_floating_point() or tensor.is_complex():
        validate.real(name, tensor)
    tensor = tensor.to(dtype)
    validate.finite(name, tensor)  # before the move: reading a CPU tensor does not synchronise with a GPU
    if device is not None and device.type != "meta":
        validate.has_numbers(name, tensor)
    return tensor.to(device=device)


def as_tensor(name: str, value: Any, dtype: torch.dtype) -> Tensor:
    """Return a tensor unchanged; convert other numbers to ``dtype`` on the CPU. TypeError if they are not numbers."""
    if isinstance(value, Tensor):
        return validate.dense(name, value)
    try:
        return torch.as_tensor(value, dtype=dtype, device="cpu")  # regardless of torch.set_default_device
    except OverflowError:
        raise ValueError(f"{name}: expected finite numbers, got one beyond 2e+308") from None
    except (TypeError, ValueError, RuntimeError):
        raise TypeError(f"{name}: expected numbers, got {type(value).__name__}") from None


def scalar(name: str, value: Any, dtype: torch.dtype, device: torch.device | None = None) -> Scalar:
    """Return a Python number unchanged; convert other values to a tensor [] or [B] (see `parameter`)."""
    if isinstance(value, (int, float)):
        return validate.number(name, value, dtype)
    return parameter(name, value, (), dtype, device)


def outside(value: Scalar, low: float, high: float) -> bool:
    """Return whether a value is outside (low, high). Tensors are read only while values are checked."""
    if isinstance(value, Tensor):
        return validate.values_are_checked(value) and not bool(((value > low) & (value < high)).all())
    return not low < value < high


def float_type(*values: Any) -> torch.dtype:
    """Promote the floating dtypes of the tensors among ``values``; torch's default dtype if there is no tensor."""
    found = [v.dtype for v in values if isinstance(v, Tensor) and v.dtype in validate.FLOATING]
    if not found:
        return torch.get_default_dtype()
    dtype = found[0]
    for other in found[1:]:
        dtype = torch.promote_types(dtype, other)
    return dtype


def common_device(*values: Any) -> torch.device:
    """Return the device of the first tensor that is not on the CPU, else the CPU."""
    for value in values:
        if isinstance(value, Tensor) and value.device.type != "cpu":
            return value.device
    return torch.device("cpu")


def batch_size(**batches: int) -> int:
    """Broadcast batch sizes, given by argument name; raise ValueError if two of them differ and neither is 1."""
    size, owner = 1, ""
    for name, batch in batches.items():
        if batch != 1 and size not in (1, batch):
            raise ValueError(f"{name}: expected a batch of 1 or {size} like {owner}, got {batch}")
        if batch != 1:
            size, owner = batch, name
    return size


def batch_of(value: Any, dims: int) -> int:
    """Return the batch size of a value with ``dims`` dimensions besides the batch; 1 if it has no batch."""
    return value.shape[0] if isinstance(value, Tensor) and value.ndim > dims else 1
