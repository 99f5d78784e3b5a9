"""Validation of public arguments. Messages have the form "what: expected, got"."""

from __future__ import annotations

import functools
import math
import reprlib
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, ParamSpec, TypeVar

import numpy as np
import torch
from torch import Tensor
from torch.fx.experimental.proxy_tensor import get_proxy_mode
from torch.utils.weak import WeakTensorKeyDictionary

from . import arrivals, numbers, private
from .arrivals import capturing
from .numbers import fraction as fraction
from .numbers import not_negative as not_negative
from .numbers import positive as positive
from .numbers import whole as whole
from .recording import recorded

P = ParamSpec("P")
R = TypeVar("R")

FLOATING = (torch.float16, torch.bfloat16, torch.float32, torch.float64)
"""Floating dtypes that torch can compute in; 8-bit floats are for storage only."""
_SMALL = (torch.uint8, torch.int8, torch.int16, torch.uint16, torch.uint32, torch.uint64)

_FAR, _STEPS = 1e6, 4  # mean coordinate, and steps of rounding across points, beyond which rounding may merge them
_FEW = 4096  # torch sums at most so many numbers on one thread

_in_range = WeakTensorKeyDictionary()  # tensors on a GPU that were checked: their version, the size, and `padded`
_check_values = True
_wait = False
_calls = threading.local()  # postponed checks of a call that is `checked_together`, and those of earlier calls


def check_values(enabled: bool, wait: bool | None = None) -> None:
    """Turn checks of tensor values on (default) or off.

    These checks find NaN, infinity and face indices out of range. On CUDA no call waits for their results: a wrong
    value raises its error in the next call that finds the GPU past it, or in the next ``check_values``, which waits.
    Values that were changed in place meanwhile are checked as they are then. Types, shapes, dtypes and devices are
    always checked, and so are values that are written to files. With the checks off, a face with a bad vertex or index
    is not drawn; gradients may then be NaN. While a CUDA graph is captured, values are not checked.

    Args:
        enabled: Whether to check values.
        wait: Whether each call waits for the GPU at its end, so that it raises its own errors: to find one. By default
            no call does; None keeps it.

    Raises:
        TypeError: An argument is not True or False.
        ValueError: A value of an earlier call on CUDA is wrong.

    Example:
        >>> nr.check_values(False)
        >>> images = nr.render(mesh, camera)
        >>> nr.check_values(True)
    """
    global _check_values, _wait
    _check_values = flag("enabled", enabled)
    _wait = _wait if wait is None else flag("wait", wait)
    _judge_earlier(wait=True)


def values_are_checked(value: Tensor) -> bool:
    """Return whether values of this tensor are checked; not under torch.compile, which cannot read them."""
    return _check_values and not (
        torch.compiler.is_compiling()
        or value.is_meta
        or type(value).__torch_dispatch__ is not Tensor.__torch_dispatch__
        or not private.may_be_read(value)
        or (private.dispatch_modes() and get_proxy_mode() is not None)
        or (value.is_cuda and capturing(value.device))
    )


def checked_together(function: Callable[P, R]) -> Callable[P, R]:
    """Decorate a public function so that its checks of values on a GPU are judged together, in a later call.

    The first check that fails raises its error; see `check_values`. Checks on the CPU raise immediately.
    """

    @functools.wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> R:
        if torch.compiler.is_compiling() or getattr(_calls, "checks", None) is not None:
            return function(*args, **kwargs)
        if getattr(_calls, "earlier", None):
            _judge_earlier()
        checks = _calls.checks = []
        try:
            result = function(*args, **kwargs)
        finally:
            _calls.checks = None
        if checks:
            numbers = torch.stack([number for number, *_ in checks])
            sent, has_arrived = (numbers, None) if _wait or numbers.device.type != "cuda" else arrivals.send(numbers)
            _earlier().append((sent, has_arrived, [check for _, *check in checks]))
            _judge_earlier()
        return result

    return call


def _earlier() -> deque[Any]:
    """Return the pending checks of this thread: numbers, functions that test whether they have arrived, and checks."""
    found = _calls.earlier = getattr(_calls, "earlier", None) or deque()
    return found


def _judge_earlier(wait: bool = False) -> None:
    """Raise the first error of the calls whose numbers have arrived; with ``wait`` of all."""
    earlier = _earlier()
    while earlier:
        numbers, has_arrived, checks = earlier[0]
        while has_arrived is not None and not has_arrived():
            if not wait or capturing(torch.device("cuda")):
                return
            time.sleep(1e-4)
        earlier.popleft()
        try:
            for number, (may_fail, check) in zip(numbers.tolist(), checks, strict=True):
                if may_fail(number):
                    check()
        except ValueError as error:
            if has_arrived is None:
                raise
            hint = "in an earlier call on the GPU; check_values(True, wait=True) finds out which"
            raise ValueError(f"{error}; {hint}") from None


def postponed(
    value: Tensor, number: Callable[[], Tensor], check: Callable[[], object], may_fail: Callable[[float], bool] = bool
) -> bool:
    """Postpone a check to the end of a call that is `checked_together`, if reading the tensor would synchronise.

    ``number`` computes one on the device, [] of any dtype, as float32, from which ``may_fail`` decides on the host
    whether the check may fail; ``check`` raises the error, if there is one. Every operation on the device takes its
    time, so the number is one that takes few. Returns whether the check is postponed; if not, the caller checks.
    """
    checks = getattr(_calls, "checks", None)
    if checks is None or value.device.type == "cpu":
        return False
    checks.append((number().float(), may_fail, check))
    return True


class called:
    """Rename arguments in the messages of checks inside the block: ``with called(size="image_size"):``."""

    def __init__(self, **names: str) -> None:
        self._names = names

    def __enter__(self) -> None: ...

    def __exit__(self, kind: type | None, error: BaseException | None, trace: object) -> None:
        if kind in (TypeError, ValueError):
            name, colon, rest = str(error).partition(":")
            if name in self._names:
                raise kind(self._names[name] + colon + rest) from None


def shape_of(value: Tensor) -> str:
    """Format a tensor's shape and dtype for messages: ``[2, 3] float32``."""
    return f"{list(value.shape)} {str(value.dtype).removeprefix('torch.')}"


def floating(name: str, value: Any, shape: Sequence[int | str]) -> Tensor:
    """Return ``value`` if it is a floating tensor whose shape fits. In ``shape``, a name stands for any size."""
    if not isinstance(value, Tensor):
        raise TypeError(f"{name}: expected a floating-point torch tensor, got {type(value).__name__}")
    if value.dtype not in FLOATING:
        real(name, value)
    _match(name, value, shape)
    return value


def real(name: str, value: Tensor) -> Tensor:
    """Return ``value`` if its dtype is floating, of 16 to 64 bits; raise TypeError otherwise."""
    if value.dtype not in FLOATING:
        is_picture = value.dtype == torch.uint8 and name.endswith(("image", "colors", "textures"))
        hint = f"; {name} / 255 is in [0, 1]" if is_picture else ""
        raise TypeError(f"{name}: expected a floating-point tensor of 16 to 64 bits, got {shape_of(value)}{hint}")
    return value


def indices(name: str, value: Any, shape: Sequence[int | str], always: bool = False) -> Tensor:
    """Convert whole numbers of any real dtype to int64; int32 and int64 stay as they are. ``shape`` as in `floating`.

    Numbers that are not whole are found while values are checked, or ``always``.
    """
    if not isinstance(value, Tensor):
        raise TypeError(f"{name}: expected a torch tensor of whole numbers, got {type(value).__name__}")
    if value.dtype not in (torch.int32, torch.int64, *_SMALL, *FLOATING):
        raise TypeError(f"{name}: expected a tensor of whole numbers, got {shape_of(value)}")
    _match(name, value, shape)
    if value.dtype in (torch.int32, torch.int64):
        return value
    result = value.detach().to(torch.int64)
    if value.dtype in FLOATING and (always or values_are_checked(value)):

        def check() -> None:
            if not bool((result == value).all()):
                raise ValueError(f"{name}: expected whole numbers, got {shape_of(value)} with fractions or NaN")

        if always or not postponed(value, lambda: (result != value).any(), check):
            check()
    return result


@recorded
def vertices(value: Any) -> Tensor:
    """Return ``value`` if it is a finite floating tensor [V, 3] or [B, V, 3]; raise otherwise, see `floating`."""
    floating("vertices", value, ("V", 3) if getattr(value, "ndim", 3) == 2 else ("B", "V", 3))
    distinct("vertices", value, finite("vertices", value))
    return value


def cubes(name: str, value: Any, *owners: int | str) -> Tensor:
    """Return ``value`` if it holds floating texture cubes [*owners, T, T, T, 3] with T ≥ 1; see `floating`."""
    floating(name, value, (*owners, "T", "T", "T", 3))
    if len(set(value.shape[-4:-1])) != 1 or value.shape[-2] < 1:
        raise ValueError(f"{name}: expected cubes [T, T, T, 3] with T at least 1, got {shape_of(value)}")
    return value


def in_float32(name: str, value: Tensor) -> Tensor:
    """Convert ``value`` to float32; raise ValueError if a number overflows, while values are checked."""
    if value.dtype != torch.float32:
        value = value.float()
        finite(f"{name}, in float32", value)
    return value


def wide(value: Tensor) -> Tensor:
    """Convert float16 and bfloat16 to float32, for computation; float32 and float64 stay as they are."""
    return value if value.dtype in (torch.float32, torch.float64) else value.float()


def dense(name: str, value: Tensor) -> Tensor:
    """Return ``value`` if it is not sparse; raise TypeError otherwise."""
    if value.layout != torch.strided:
        raise TypeError(f"{name}: expected a dense tensor, got {shape_of(value)} of layout {value.layout}")
    return value


def has_numbers(name: str, value: Tensor) -> Tensor:
    """Return ``value`` unless it is on the device "meta", which holds no numbers; raise ValueError otherwise."""
    if value.is_meta:
        raise ValueError(f'{name}: expected a tensor with numbers, got one on the device "meta"')
    return value


def _match(name: str, value: Tensor, shape: Sequence[int | str]) -> None:
    """Raise ValueError unless the shape fits; see `floating`."""
    if value.layout != torch.strided:
        dense(name, value)
    have = value.shape
    fits = len(shape) == len(have)
    if fits:
        for want, got in zip(shape, have, strict=True):  # a loop, because `any` takes twice as long
            if want != got and type(want) is not str:
                fits = False
    if not fits:
        wanted = "[" + ", ".join(str(s) for s in shape) + "]"
        raise ValueError(f"{name}: expected shape {wanted}, got {shape_of(value)}")


def same_device(**tensors: Tensor | None) -> torch.device:
    """Return the common device of tensors, given by argument name; raise ValueError if two differ."""
    first_name, device = "", None
    for name, tensor in tensors.items():
        if tensor is None:
            continue
        if device is None:
            first_name, device = name, tensor.device
        elif tensor.device != device:
            raise ValueError(f"{name}: expected device {device} like {first_name}, got {tensor.device}")
    return device  # type: ignore[return-value]  # one tensor at least is given


@recorded
def finite(name: str, value: Tensor, always: bool = False) -> float:
    """Raise ValueError if a number is not finite, while values are checked (see `check_values`) or with ``always``.

    Returns the sum of the numbers, 0 if they are not checked now.
    """
    if not (always or values_are_checked(value)) or not value.numel():
        return 0.0
    value = value.detach()
    on_cpu = value.device.type == "cpu"
    if not (always or on_cpu) and postponed(
        value, value.sum, lambda: finite(name, value, True), lambda total: not math.isfinite(total)
    ):
        return 0.0
    # A sum is NaN or infinite if any term is: one pass without a mask. `isfinite` then rules out that finite numbers
    # overflowed. NumPy sums many numbers on the CPU, because torch's idle threads would spin on cores that the kernels
    # need; einsum does it, because `sum` adds in pairs, which takes up to twice as long.
    if value.numel() > _FEW and on_cpu and value.dtype in (torch.float32, torch.float64):
        with np.errstate(all="ignore"):
            numbers: Any = np.from_dlpack(value.resolve_neg())  # `numpy()` would forbid torch to resize the memory
            total = float(np.einsum(numbers, [*range(numbers.ndim)], []))
    else:
        total = value.sum().item()
    if not math.isfinite(total) and not bool(torch.isfinite(value).all()):
        raise ValueError(
            f"{name}: expected finite numbers, got {int((~torch.isfinite(value)).sum())} that are NaN or infinite"
        )
    return total


def distinct(name: str, value: Tensor, total: float) -> None:
    """Raise ValueError if points [..., V, 3] with this sum are so far from the origin that rounding makes them one."""
    if not _FAR * value.numel() < abs(total) < math.inf:
        return
    low, high = value.detach().aminmax(dim=-2)
    largest = torch.maximum(low.abs(), high.abs()).amax(-1)
    step = torch.finfo(value.dtype).eps * largest
    if bool(((high - low).amax(-1) < _STEPS * step).any()):
        raise ValueError(
            f"{name}: expected points that {str(value.dtype)[6:]} tells apart, "
            f"got coordinates of {float(largest.max()):.2g} in steps of {float(step.max()):.2g}; "
            "move the mesh and the camera to the origin"
        )


@recorded
def in_range(name: str, value: Tensor, size: int, always: bool = False, padded: bool = False) -> None:
    """Raise ValueError if an index is outside [0, size), while values are checked or with ``always``.

    With ``padded``, rows in which every index is -1 are allowed, unless ``size`` is 0. On a GPU, where the check takes
    longer than some steps, only the first call with a tensor checks it, until torch counts a change of it.
    """
    if not (always or values_are_checked(value)) or not value.numel():
        return
    if not always and value.device.type != "cpu":
        version = private.version_of(value)
        known, least, as_padded = _in_range.get(value, (None, 0, padded))
        if version is not None and known == version and least <= size and as_padded <= padded:
            return

        def check() -> None:
            _in_range.pop(value, None)
            in_range(name, value, size, True, padded)

        if postponed(value, lambda: _out_of_range(value, size, padded), check):
            _in_range[value] = version, size, padded
            return
    low, high = least_and_greatest(value)
    if padded and low == -1 and size:
        low = int(torch.where((value == -1).all(-1, keepdim=True), 0, value).min())
    if low < 0 or high >= size:
        raise ValueError(f"{name}: expected indices in [0, {size}), got {low if low < 0 else high}")


def least_and_greatest(value: Tensor) -> tuple[int, int]:
    """Return the least and the greatest of integers; waits for their device."""
    if value.device.type != "cpu" or value.numel() <= _FEW:
        low, high = torch.aminmax(value)
        return int(low), int(high)
    numbers = np.from_dlpack(value.detach())  # as in `finite`: torch's threads would take cores from the kernels
    return int(numbers.min()), int(numbers.max())


def _out_of_range(value: Tensor, size: int, padded: bool) -> Tensor:
    wrong = (value < 0) | (value >= size)
    return (wrong & ~(value == -1).all(-1, keepdim=True)).any() if padded and size else wrong.any()


def number(name: str, value: Any, dtype: torch.dtype = torch.float64) -> float:
    """Convert ``value`` to a float that is finite in ``dtype``; raise TypeError or ValueError otherwise."""
    found = numbers.number(name, value)
    most = torch.finfo(dtype).max
    if not -most <= found <= most:
        raise ValueError(f"{name}: expected a number that {str(dtype).removeprefix('torch.')} holds, got {found:g}")
    return found


def flag(name: str, value: Any) -> bool:
    """Convert True, False, 0 or 1 to a bool; raise TypeError for other values."""
    if not isinstance(value, (bool, int, np.bool_, np.integer)) or value not in (0, 1):
        raise TypeError(f"{name}: expected True or False, got {reprlib.repr(value)}")
    return bool(value)
