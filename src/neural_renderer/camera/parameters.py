"""Parameters of cameras and lights as tensors: one for all views, or one for each view of a batch."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
import torch
from torch import Tensor

from .. import validate

Scalar: TypeAlias = float | Tensor
"""A number, or a tensor [] or [B]: one number for each view."""
Array: TypeAlias = Tensor | np.ndarray | Sequence[Any]
"""Numbers as a tensor, an array or nested lists, with or without a leading batch dimension."""


def parameter(
    name: str, value: Any, size: tuple[int, ...], dtype: torch.dtype, device: torch.device | None = None
) -> Tensor:
    """``value`` as a tensor of shape ``size`` or ``[B, *size]``, of ``dtype``, on ``device`` (None: where it is).

    Gradients flow through. Raises TypeError for anything that is not numbers; ValueError for another shape, and for
    NaN or infinity if values are checked.
    """
    tensor = as_tensor(name, value, dtype)
    dims = tensor.ndim - len(size)
    if dims not in (0, 1) or tuple(tensor.shape[dims:]) != size:
        sizes = ", ".join(str(s) for s in size)
        batched = f"B, {sizes}" if size else "B"
        raise ValueError(f"{name}: expected shape [{sizes}] or [{batched}], got {validate.shape_of(tensor)}")
    if tensor.is_floating_point() or tensor.is_complex():
        validate.real(name, tensor)
    tensor = tensor.to(dtype)
    validate.finite(name, tensor)  # before the move: what was given on the CPU is read there, without a wait
    if device is not None and device.type != "meta":
        validate.has_numbers(name, tensor)
    return tensor.to(device=device)


def as_tensor(name: str, value: Any, dtype: torch.dtype) -> Tensor:
    """A tensor as it is; anything else as a tensor of ``dtype`` on the CPU. TypeError if it is not numbers."""
    if isinstance(value, Tensor):
        return validate.dense(name, value)
    try:
        return torch.as_tensor(value, dtype=dtype, device="cpu")  # whatever torch.set_default_device says
    except (TypeError, ValueError, RuntimeError, OverflowError):
        raise TypeError(f"{name}: expected numbers, got {type(value).__name__}") from None


def scalar(name: str, value: Any, dtype: torch.dtype, device: torch.device | None = None) -> Scalar:
    """A Python number as it is; anything else as a tensor [] or [B] of ``dtype`` on ``device`` (see `parameter`)."""
    if isinstance(value, (int, float)):
        return validate.number(name, value, dtype)
    return parameter(name, value, (), dtype, device)


def outside(value: Scalar, low: float, high: float) -> bool:
    """Whether a number lies outside (low, high), or one of a tensor's if values are checked."""
    if isinstance(value, Tensor):
        return validate.values_are_checked(value) and not bool(((value > low) & (value < high)).all())
    return not low < value < high


def float_type(*values: Any) -> torch.dtype:
    """The floating dtype in which the tensors among ``values`` meet; torch's default dtype if there is none."""
    found = [v.dtype for v in values if isinstance(v, Tensor) and v.dtype in validate.FLOATING]
    if not found:
        return torch.get_default_dtype()
    dtype = found[0]
    for other in found[1:]:
        dtype = torch.promote_types(dtype, other)
    return dtype


def common_device(*values: Any) -> torch.device:
    """The accelerator on which one of the values lives, else the CPU, where three numbers are soonest ready."""
    devices = [v.device for v in values if isinstance(v, Tensor)]
    return next((d for d in devices if d.type != "cpu"), torch.device("cpu"))


def batch_size(**batches: int) -> int:
    """The one batch size, where 1 fits any other; ValueError names two that do not fit."""
    size, owner = 1, ""
    for name, batch in batches.items():
        if batch != 1 and size not in (1, batch):
            raise ValueError(f"{name}: expected a batch of 1 or {size} like {owner}, got {batch}")
        if batch != 1:
            size, owner = batch, name
    return size


def batch_of(value: Any, dims: int) -> int:
    """The batch size of a value that has ``dims`` dimensions without a batch."""
    return value.shape[0] if isinstance(value, Tensor) and value.ndim > dims else 1
