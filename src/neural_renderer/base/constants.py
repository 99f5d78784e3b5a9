"""Cache of constants on a GPU and of numbers read from it, because each copy synchronises."""

from __future__ import annotations

import functools
from collections.abc import Callable, Hashable
from typing import Any

import torch
from torch import Tensor
from torch.utils.weak import WeakTensorKeyDictionary

from . import private
from .arrivals import capturing

_LARGEST = torch.finfo(torch.float16).max
_FEW = 256  # most numbers that a CUDA graph gets without a copy, by as many launches
_copies = WeakTensorKeyDictionary()
_numbers = WeakTensorKeyDictionary()


def constant(value: Any, dtype: torch.dtype, device: torch.device) -> Tensor | None:
    """Return a shared tensor of a number or of nested lists of numbers. Do not change it or return it to a user.

    Returns None for other values, for values beyond float16, and under torch.compile, torch.func or a dispatch mode,
    where tensors have other types.
    """
    if torch.compiler.is_compiling() or private.dispatch_modes() or private.transforms_active():
        return None
    numbers = _hashable(value)
    try:
        make = _constant.__wrapped__ if capturing(device) else _constant
        return None if numbers is None else make(numbers, dtype, device)
    except ValueError:  # lists of different lengths
        return None


def old_device() -> torch.device:
    """Return the device on which the first packages make tensors: torch's default if set, else CUDA or the CPU."""
    return private.default_device() or torch.device("cuda" if torch.cuda.is_available() else "cpu")


def on_device(tensor: Tensor, like: Tensor) -> Tensor:
    """Convert a tensor to the device and dtype of another; cache copies on other devices while the tensor lives."""
    if tensor.device == like.device and tensor.dtype == like.dtype:
        return tensor
    kept_nowhere = like.is_meta or torch.compiler.is_compiling()  # torch.compile 2.11 does not know `is_inference`
    kept_nowhere = kept_nowhere or tensor.device == like.device or tensor.requires_grad
    if kept_nowhere or (version := private.version_of(tensor)) is None:
        return tensor.to(like)
    if tensor.is_cpu and tensor.numel() <= _FEW and capturing(like.device):
        return _filled(tensor.to(like.dtype), like.device)
    key = (version, like.device, like.dtype)
    kept = _copies.get(tensor)
    if kept is None or kept[0] != key:
        with torch.inference_mode(False):
            kept = _copies[tensor] = (key, tensor.to(like))
    return kept[1]


def read_once(tensor: Tensor, read: Callable[[Tensor], Any]) -> Any:
    """Return ``read(tensor)``; on a GPU, cache it until the tensor changes, because reading synchronises."""
    if tensor.device.type == "cpu" or (version := private.version_of(tensor)) is None:
        return read(tensor)
    kept = _numbers.get(tensor)
    if kept is None or kept[:2] != (version, read):
        kept = _numbers[tensor] = (version, read, read(tensor))
    return kept[2]


@functools.lru_cache(maxsize=256)
def _constant(value: Any, dtype: torch.dtype, device: torch.device) -> Tensor:
    with torch.inference_mode(False):  # backward cannot use an inference tensor
        made = torch.tensor(value, dtype=dtype, device="cpu")
        return made if device.type == "cpu" else _filled(made, device)


def _filled(numbers: Tensor, device: torch.device) -> Tensor:
    """Make the same tensor on a device without a copy from the host, which a CUDA graph could not capture."""
    parts = [torch.full((1,), number, dtype=numbers.dtype, device=device) for number in numbers.flatten().tolist()]
    return torch.cat(parts).view(numbers.shape) if parts else torch.empty(numbers.shape, device=device)


def _hashable(value: Any) -> Hashable | None:
    """Convert nested lists of numbers to tuples; None for anything else."""
    if type(value) in (int, float):
        return value if abs(value) <= _LARGEST else None
    if not isinstance(value, (tuple, list)) or len(value) > 16:
        return None
    parts = tuple(map(_hashable, value))
    return None if None in parts else parts
