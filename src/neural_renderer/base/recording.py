"""Recording of a step for `raster.warp.replay`: its launches of kernels, torch's operators and checks of values.

A tensor of the step is a view of a piece of memory, which is found by its address. Other tensors are constants.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, ParamSpec, TypeVar

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode

from . import private

P = ParamSpec("P")
R = TypeVar("R")

_EMPTY = ("aten::empty", "aten::new_empty", "aten::empty_like")  # operators whose results kernels write
_READS = {"numpy", "tolist", "__dlpack__", "__array__", "untyped_storage", "storage"}  # of values, unseen by dispatch


class Unrepeatable(Exception):
    """A step cannot be recorded, for example because what it launches depends on values."""


class View(NamedTuple):
    """A tensor of a recorded step."""

    memory: int  # number of the piece of memory
    offset: int  # in bytes
    dtype: torch.dtype
    shape: tuple[int, ...]
    stride: tuple[int, ...]


@dataclass
class Memory:
    """A piece of memory of a recorded step, from the first number of a tensor to the end of its storage."""

    tensor: Tensor  # alive until the recording ends, so that no other tensor gets its address
    kind: str  # "given" to the step, "made" for kernels to write, or "computed" by an operator of torch
    backward: bool  # whether the backward pass gets or makes it
    is_zero: bool = False  # made of zeros
    crosses: bool = False  # whether it is of the forward pass, and the backward pass reads it

    def __post_init__(self) -> None:
        self.first = self.tensor.data_ptr()
        self.size = self.tensor.untyped_storage().nbytes() - self.tensor.storage_offset() * self.tensor.itemsize


class Launch(NamedTuple):
    """A launch of a kernel."""

    arguments: tuple[Any, ...]  # kernel, tasks, call, device and least number of tasks, as of `launch`
    pointers: list[tuple[int, int, int]]  # of the call: the field's offset, the memory, and the offset there
    constants: list[Tensor]  # tensors to which the other pointers refer


class Operation(NamedTuple):
    """A call of an operator of torch, or a check of values, with a `View` in the place of each tensor."""

    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    named: dict[str, Any]
    result: int = -1  # number of the memory that it makes; -1 for none


class _Reads(TorchFunctionMode):
    """Refuses reads of values that no operator of torch shows to the recorder."""

    def __init__(self, recorder: Recorder) -> None:
        super().__init__()
        self._recorder = recorder

    def __torch_function__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        if getattr(function, "__name__", "") in _READS and self._recorder.depends_on(args):
            raise Unrepeatable(f"{function.__name__}: values are read")
        return function(*args, **(kwargs or {}))


class Recorder(private.DispatchMode):  # type: ignore[misc]
    """A mode of torch that records what runs inside it."""

    def __init__(self) -> None:
        super().__init__()
        self.memories: list[Memory] = []
        self.steps: list[Launch | Operation] = []
        self.checks: list[Operation] = []
        self.backward = False
        self._checks_values = False
        self._reads = _Reads(self)

    def __enter__(self) -> Recorder:
        self._reads.__enter__()  # type: ignore[no-untyped-call]
        super().__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        super().__exit__(*error)
        self._reads.__exit__(*error)  # type: ignore[no-untyped-call]

    def depends_on(self, args: Sequence[Any]) -> bool:
        """Test whether arguments hold a tensor of the step, outside of checks."""
        return not self._checks_values and any(isinstance(each, Tensor) and self.find(each) for each in args)

    def __torch_dispatch__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        result = function(*args, **(kwargs or {}))
        given = [part for each in args for part in (each if isinstance(each, (list, tuple)) else [each])]
        given = [each for each in given if isinstance(each, Tensor)]
        if self._checks_values or (given and all(self.find(each) is None for each in given)):
            return result  # of constants
        changes, is_tensor = function._schema.is_mutable, isinstance(result, Tensor)
        if function.is_view or (is_tensor and not changes and self.find(result) is not None):
            return result
        if not is_tensor or not result.is_contiguous():
            raise Unrepeatable(str(function))  # such as a number, on which later steps may depend
        if function._schema.name in _EMPTY:
            self.hold(result, "made")
            return result
        place = -1 if changes or not result.numel() else self.hold(result, "computed")
        self.steps.append(Operation(function, self._views(args), kwargs or {}, place))
        return result

    def hold(self, tensor: Tensor, kind: str, is_zero: bool = False) -> int:
        """Add the memory of a tensor; return its number."""
        self.memories.append(Memory(tensor, kind, self.backward, is_zero))
        return len(self.memories) - 1

    def find(self, tensor: Tensor) -> View | None:
        """Return the view that a tensor is; None for a constant."""
        address = tensor.data_ptr()
        for number, memory in enumerate(self.memories if tensor.numel() else ()):
            if 0 <= address - memory.first < memory.size:
                memory.crosses |= self.backward and not memory.backward
                return View(number, address - memory.first, tensor.dtype, tensor.shape, tensor.stride())
        return None

    def _views(self, value: Any) -> Any:
        if isinstance(value, Tensor):
            return self.find(value) or value
        return tuple(map(self._views, value)) if isinstance(value, (list, tuple)) else value

    def launch(self, kernel: Any, tasks: int, arguments: Sequence[Any], device: torch.device, least: int) -> None:
        """Record a launch of a kernel; arguments as of `launch`."""
        self.steps.append(Launch((kernel, tasks, *arguments, device, least), [], []))
        self._add_pointers(self.steps[-1], arguments[0], 0)

    def _add_pointers(self, step: Any, call: Any, start: int) -> None:
        for name, value in call.kept.items():
            offset = start + getattr(type(call), name).offset
            view = self.find(value) if isinstance(value, Tensor) else None
            if hasattr(value, "kept"):
                self._add_pointers(step, value, offset)
            elif view is not None:
                step.pointers.append((offset, view.memory, view.offset))
            elif isinstance(value, Tensor):
                if value.numel() and name not in call._read:
                    raise Unrepeatable(f"{type(call).__name__}.{name}: a kernel writes to a constant")
                step.constants.append(value)

    def check(self, function: Callable[..., R], args: tuple[Any, ...], named: dict[str, Any]) -> R:
        """Make a check of values, and record it, but not what it calls."""
        if self._checks_values:
            return function(*args, **named)
        self._checks_values = True
        try:
            result = function(*args, **named)
        finally:
            self._checks_values = False
        if self.depends_on(args):
            self.checks.append(Operation(function, self._views(args), named))
        return result


def recorder() -> Recorder | None:
    """Return the recorder of this thread, or of the backward pass that it runs; None if nothing is recorded."""
    if torch.compiler.is_compiling() or not private.dispatch_modes():
        return None
    mode = private.dispatch_mode()
    return mode if isinstance(mode, Recorder) else None


def recorded(check: Callable[P, R]) -> Callable[P, R]:
    """Decorate a check of values, so that a recorded step makes it again; its tensors are positional arguments."""

    @functools.wraps(check)
    def call(*args: P.args, **named: P.kwargs) -> R:
        found = recorder()
        return check(*args, **named) if found is None else found.check(check, args, named)

    return call
