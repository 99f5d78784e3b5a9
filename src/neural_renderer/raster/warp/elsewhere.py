"""Tensors on devices without kernels, such as the GPUs of Apple, Intel and AMD: computed on the CPU."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable
from typing import Any, ParamSpec, TypeVar

import torch
from torch import Tensor

from ...base import validate
from ...io.files import warn

P = ParamSpec("P")
R = TypeVar("R")

_ON_CUDA = torch.version.hip is None  # AMD's GPUs are "cuda" in torch, but Warp has no compiler for them

_allowed = True
_warned: set[str] = set()  # devices that a warning has named


def fall_back_to_cpu(enabled: bool) -> None:
    """Allow (default) or forbid tensors on devices other than the CPU and NVIDIA's GPUs.

    Allowed, everything that the kernels compute is computed on the CPU, and the results, gradients too, come back on
    the device of the tensors. A warning says so at the first call. Every call copies its tensors there and back.

    Args:
        enabled: Whether to compute on the CPU. If not, such tensors are an error (ValueError).

    Raises:
        TypeError: ``enabled`` is not True or False.

    Example:
        >>> nr.fall_back_to_cpu(False)  # an error instead of a slow step
        >>> nr.fall_back_to_cpu(True)
    """
    global _allowed
    _allowed = validate.flag("enabled", enabled)


def runs_kernels(tensor: Tensor) -> bool:
    """Test whether kernels run on the device of a tensor."""
    return tensor.is_cpu or (tensor.is_cuda and _ON_CUDA)


def check_devices(values: Iterable[Any], name: str = "tensors") -> None:
    """Warn once that the device of a tensor has no kernels, or raise ValueError if `fall_back_to_cpu` forbids it."""
    device = _elsewhere(values)
    if device is None:
        return
    if not _allowed:
        raise ValueError(f"{name}: expected the CPU or an NVIDIA GPU, got device {device}")
    if device.type not in _warned:
        _warned.add(device.type)
        warn(f"{name}: there are no kernels for the device {device}; images and gradients are computed on the CPU")


def on_any_device(function: Callable[P, R]) -> Callable[P, R]:
    """Decorate a function of kernels: its tensors on devices without kernels are copied to the CPU, and results back.

    Raises ValueError for such tensors if `fall_back_to_cpu` forbids them.
    """
    plain: Callable[..., Any] = function

    @functools.wraps(function)
    def call(*inputs: Any, **named: Any) -> Any:
        device = _elsewhere(inputs)
        if device is None:
            return plain(*inputs, **named)
        check_devices(inputs)
        results = plain(*(each.cpu() if isinstance(each, Tensor) else each for each in inputs), **named)
        return results.to(device) if isinstance(results, Tensor) else tuple(each.to(device) for each in results)

    return call


def _elsewhere(values: Iterable[Any]) -> torch.device | None:
    """Find the device without kernels among those of tensors; None if there is none."""
    for each in values:
        if isinstance(each, Tensor) and not (runs_kernels(each) or each.is_meta):
            return each.device
    return None
