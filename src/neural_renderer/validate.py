"""The checks of the public border: each raises with a sentence "what: expected, got"."""

from __future__ import annotations

import math
import reprlib
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from torch import Tensor

FLOATING = (torch.float16, torch.bfloat16, torch.float32, torch.float64)
"""The floating dtypes that torch computes in; those of 8 bits and fewer only store."""
_SMALL = (torch.uint8, torch.int8, torch.int16, torch.uint16, torch.uint32, torch.uint64)

_check_values = True


def check_values(enabled: bool) -> None:
    """Turn the checks that must read a tensor's numbers on (default) or off, for hot loops.

    They find numbers that are NaN or infinite and face indices out of range. On CUDA each makes the host wait for the
    device once; shapes, dtypes and devices are always checked, because that costs nothing, and so is what goes into a
    file. With the checks off, a face that has such a vertex or index is not drawn and nothing crashes, but gradients
    may not be numbers.
    """
    global _check_values
    _check_values = bool(enabled)


def values_are_checked(value: Tensor) -> bool:
    """Whether the numbers of ``value`` are checked now.

    Never where they cannot be read: while torch.compile traces, under torch.func, on the device "meta", in tensors
    that only look like ones (FakeTensor), while make_fx traces.
    """
    return _check_values and not (
        torch.compiler.is_compiling()
        or value.is_meta
        or type(value).__torch_dispatch__ is not Tensor.__torch_dispatch__
        or torch._C._are_functorch_transforms_active()
        or torch._C._get_dispatch_mode(torch._C._TorchDispatchModeKey.PROXY) is not None
    )


@contextmanager
def called(**names: str) -> Iterator[None]:
    """Messages of the checks inside name arguments as the caller wrote them: ``called(size="image_size")``."""
    try:
        yield
    except (TypeError, ValueError) as error:
        name, colon, rest = str(error).partition(":")
        if name not in names:
            raise
        raise type(error)(names[name] + colon + rest) from None


def shape_of(value: Tensor) -> str:
    """A tensor's shape and dtype as the messages write it: ``[2, 3] float32``."""
    return f"{list(value.shape)} {str(value.dtype).removeprefix('torch.')}"


def floating(name: str, value: Any, shape: Sequence[int | str]) -> Tensor:
    """``value`` if it is a floating tensor whose shape fits: an int must match, a name stands for any size.

    Raises TypeError for anything else than a floating tensor and
    ValueError for another shape.
    """
    if not isinstance(value, Tensor):
        raise TypeError(f"{name}: expected a floating-point torch tensor, got {type(value).__name__}")
    _match(name, real(name, value), shape)
    return value


def real(name: str, value: Tensor) -> Tensor:
    """``value`` if it is of 16 to 64 bits floating; TypeError otherwise."""
    if value.dtype not in FLOATING:
        raise TypeError(f"{name}: expected a floating-point tensor of 16 to 64 bits, got {shape_of(value)}")
    return value


def indices(name: str, value: Any, shape: Sequence[int | str], always: bool = False) -> Tensor:
    """``value`` as an int32 or int64 tensor, if it holds whole numbers of any real dtype and its shape fits.

    int32 and int64 come back as they are, others as int64 (see `floating` for the shape). Raises TypeError for anything
    else than a tensor of real numbers, ValueError for another shape, and for other numbers if values are checked, or
    ``always``.
    """
    if not isinstance(value, Tensor):
        raise TypeError(f"{name}: expected a torch tensor of whole numbers, got {type(value).__name__}")
    if value.dtype not in (torch.int32, torch.int64, *_SMALL, *FLOATING):
        raise TypeError(f"{name}: expected a tensor of whole numbers, got {shape_of(value)}")
    _match(name, value, shape)
    if value.dtype in (torch.int32, torch.int64):
        return value
    result = value.detach().to(torch.int64)
    checked = value.dtype in FLOATING and (always or values_are_checked(value))
    if checked and not bool((result == value).all()):
        raise ValueError(f"{name}: expected whole numbers, got {shape_of(value)} with others")
    return result


def vertices(value: Any) -> Tensor:
    """``value`` if it is a floating tensor [V, 3] or [B, V, 3] of finite numbers; TypeError or ValueError otherwise."""
    floating("vertices", value, ("V", 3) if getattr(value, "ndim", 3) == 2 else ("B", "V", 3))
    finite("vertices", value)
    return value


def cubes(name: str, value: Any, *owners: int | str) -> Tensor:
    """``value`` if it is a floating tensor of texture cubes [*owners, T, T, T, 3], T at least 1 (see `floating`)."""
    floating(name, value, (*owners, "T", "T", "T", 3))
    if len(set(value.shape[-4:-1])) != 1 or value.shape[-2] < 1:
        raise ValueError(f"{name}: expected cubes [T, T, T, 3] with T at least 1, got {shape_of(value)}")
    return value


def in_float32(name: str, value: Tensor) -> Tensor:
    """``value`` in float32; ValueError if it had another type that does not fit and values are checked."""
    if value.dtype != torch.float32:
        value = value.float()
        finite(f"{name}, in float32", value)
    return value


def wide(value: Tensor) -> Tensor:
    """float16 and bfloat16 as float32, in which is computed; float32 and float64 as they are."""
    return value if value.dtype in (torch.float32, torch.float64) else value.float()


def dense(name: str, value: Tensor) -> Tensor:
    """``value`` if it is not sparse; TypeError otherwise."""
    if value.layout != torch.strided:
        raise TypeError(f"{name}: expected a dense tensor, got {shape_of(value)} of layout {value.layout}")
    return value


def has_numbers(name: str, value: Tensor) -> Tensor:
    """``value`` if it is on a device that holds numbers; ValueError otherwise."""
    if value.is_meta:
        raise ValueError(f'{name}: expected a tensor with numbers, got one on the device "meta"')
    return value


def _match(name: str, value: Tensor, shape: Sequence[int | str]) -> None:
    dense(name, value)
    if len(shape) != value.dim() or any(
        isinstance(want, int) and want != have for want, have in zip(shape, value.shape, strict=True)
    ):
        wanted = "[" + ", ".join(str(s) for s in shape) + "]"
        raise ValueError(f"{name}: expected shape {wanted}, got {shape_of(value)}")


def same_device(**tensors: Tensor | None) -> torch.device:
    """The one device on which all the given tensors live; ValueError names the two that differ."""
    first_name, first = next((name, t) for name, t in tensors.items() if t is not None)
    for name, tensor in tensors.items():
        if tensor is not None and tensor.device != first.device:
            raise ValueError(f"{name}: expected device {first.device} like {first_name}, got {tensor.device}")
    return first.device


def finite(name: str, value: Tensor, always: bool = False) -> None:
    """ValueError if ``value`` holds NaN or infinity and values are checked (see `check_values`), or ``always``."""
    if not (always or values_are_checked(value)) or not value.numel():
        return
    value = value.detach().resolve_neg()  # which NumPy does not know
    # A sum is NaN or infinite if any term is: one pass without a mask. The second look rules out that finite numbers
    # overflowed. NumPy's sum on the CPU, because torch's threads would go on spinning where the kernels' want to run.
    plain = value.device.type == "cpu" and value.dtype in (torch.float32, torch.float64)
    with np.errstate(all="ignore"):
        total = float(value.numpy().sum()) if plain else value.sum().item()
    if not math.isfinite(total) and not bool(torch.isfinite(value).all()):
        raise ValueError(
            f"{name}: expected finite numbers, got {int((~torch.isfinite(value)).sum())} that are NaN or infinite"
        )


def in_range(name: str, value: Tensor, size: int, always: bool = False) -> None:
    """ValueError if an index is outside ``[0, size)`` and values are checked (see `check_values`), or ``always``."""
    if (always or values_are_checked(value)) and value.numel():
        low, high = (int(v) for v in torch.aminmax(value))
        if low < 0 or high >= size:
            raise ValueError(f"{name}: expected indices in [0, {size}), got {low if low < 0 else high}")


def number(name: str, value: Any, dtype: torch.dtype = torch.float64) -> float:
    """``value`` as a float that is finite in ``dtype``; TypeError or ValueError otherwise."""
    try:
        if isinstance(value, str):  # which float() would read
            raise TypeError
        found = float(value.item() if isinstance(value, Tensor) else value)
    except OverflowError:  # a whole number, of too many digits to show
        raise ValueError(f"{name}: expected a finite number, got one beyond {sys.float_info.max:.0e}") from None
    except (TypeError, ValueError, RuntimeError):
        got = shape_of(value) if isinstance(value, Tensor) else type(value).__name__
        raise TypeError(f"{name}: expected a number, got {got}") from None
    if not -math.inf < found < math.inf:
        raise ValueError(f"{name}: expected a finite number, got {found}")
    most = torch.finfo(dtype).max
    if not -most <= found <= most:
        raise ValueError(f"{name}: expected a number that {str(dtype).removeprefix('torch.')} holds, got {found:g}")
    return found


def positive(name: str, value: Any) -> float:
    """``value`` as a finite float above 0; TypeError or ValueError otherwise."""
    found = number(name, value)
    if found <= 0:
        raise ValueError(f"{name}: expected a finite number above 0, got {value}")
    return found


def not_negative(name: str, value: Any) -> float:
    """``value`` as a finite float of at least 0; TypeError or ValueError otherwise."""
    found = number(name, value)
    if found < 0:
        raise ValueError(f"{name}: expected a number of at least 0, got {value}")
    return found


def flag(name: str, value: Any) -> bool:
    """``value`` if it is True or False (0 and 1 pass too); TypeError otherwise."""
    if not isinstance(value, (bool, int, np.bool_, np.integer)) or value not in (0, 1):
        raise TypeError(f"{name}: expected True or False, got {reprlib.repr(value)}")
    return bool(value)


def whole(name: str, value: Any, least: int) -> int:
    """``value`` as an int of at least ``least``; TypeError or ValueError otherwise."""
    found = number(name, value)
    if found != int(found):
        raise TypeError(f"{name}: expected a whole number, got {value}")
    if found < least:
        raise ValueError(f"{name}: expected at least {least}, got {value}")
    return int(found)
