"""`cuda_on_cpu`: a context in which "cuda" means the CPU, for programs on a machine without CUDA.

A torch function mode replaces the device in calls of torch's functions. Functions that no mode intercepts, such as
`torch.cuda.synchronize`, are replaced in their modules while the context lasts.
"""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode

from ...base import private
from ...raster.warp.launch import has_cuda

_CPU = torch.device("cpu")
_SEEN = torch.device("cpu", 0)  # the device that programs see; like one of CUDA, it has an index
_DEVICE_OF = Tensor.device.__get__
_MEMORY = 8 << 30  # reported memory of the device in bytes
_MAKES_VIEWS = (torch.as_tensor, torch.asarray)  # they share memory with the caller


class _OnCPU(TorchFunctionMode):
    """Replaces devices of CUDA in calls of torch's functions."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        if kwargs.get("pin_memory"):  # page-locked memory needs CUDA
            kwargs["pin_memory"] = False
        if func in (Tensor.cuda, Tensor.cpu):
            return _copied(args[0])
        if func is Tensor.pin_memory:
            return args[0]
        if "device" in kwargs:
            kwargs["device"] = _number_on_cpu(kwargs["device"])
        if func is Tensor.to or (func is torch.device and len(args) == 1):
            args = tuple(map(_number_on_cpu, args))
        if func == _DEVICE_OF or func is torch.device:
            device = func(*args, **kwargs)
            return _SEEN if device.type == "cpu" else device
        if func is Tensor.get_device:
            return _SEEN.index
        if not any(map(_is_cuda, (*args, *kwargs.values()))):
            result = func(*args, **kwargs)
            unchanged = func is Tensor.to and result is args[0]
            named = any(isinstance(value, (str, torch.device)) for value in (*args[1:], *kwargs.values()))
            return _copied(result) if unchanged and named else result  # a call with a device copies the tensor
        result = func(*map(_on_cpu, args), **{name: _on_cpu(value) for name, value in kwargs.items()})
        shares = func in _MAKES_VIEWS or (func is Tensor.to and result is args[0])
        return _copied(result) if shares else result


def _copied(tensor: Tensor) -> Tensor:
    """Copy a tensor, as a move between devices does; return a tensor that requires gradients, which may be a leaf."""
    return tensor if tensor.requires_grad else tensor.clone()


def _is_cuda(value: Any) -> bool:
    if isinstance(value, torch.device):
        return value.type == "cuda"
    return isinstance(value, str) and (value == "cuda" or value.startswith(("cuda:", "torch.cuda.")))


def _on_cpu(value: Any) -> Any:
    """Replace a CUDA device by the CPU, and a CUDA tensor type by that of the CPU; return other values."""
    if not _is_cuda(value):
        return value
    return value.replace("torch.cuda.", "torch.") if str(value).startswith("torch.") else _CPU


def _number_on_cpu(value: Any) -> Any:
    """Replace the number of a CUDA device by the CPU; return other values."""
    return _CPU if type(value) is int else value


class _Generator(torch.Generator):
    """`torch.Generator`, which takes "cuda" as the CPU."""

    def __new__(cls, device: Any = "cpu") -> Any:
        return super().__new__(cls, _on_cpu(device))  # type: ignore[call-arg]


class _Stream:
    """A stream; on the CPU, work is complete when a call returns."""

    cuda_stream = 0

    def __init__(self, *_: Any, **__: Any) -> None: ...

    def __enter__(self) -> _Stream:
        return self

    def __exit__(self, *_: Any) -> None: ...

    def synchronize(self) -> None: ...

    def wait_stream(self, stream: Any) -> None: ...

    def wait_event(self, event: Any) -> None: ...

    def query(self) -> bool:
        return True

    def record_event(self, event: Any = None) -> Any:
        event = _Event() if event is None else event
        event.record()
        return event


class _Event:
    """An event, which stores the time of its recording."""

    def __init__(self, *_: Any, **__: Any) -> None:
        self._time = 0.0

    def record(self, stream: Any = None) -> None:
        self._time = time.perf_counter()

    def synchronize(self) -> None: ...

    def wait(self, stream: Any = None) -> None: ...

    def query(self) -> bool:
        return True

    def elapsed_time(self, end: _Event) -> float:
        return (end._time - self._time) * 1000


class _Properties:
    """Result of `torch.cuda.get_device_properties`."""

    name, major, minor, total_memory, multi_processor_count = "CPU", 8, 0, _MEMORY, 1


class _DataParallel(torch.nn.Module):
    """One device in place of several, as `torch.nn.DataParallel` without any GPU."""

    def __init__(self, module: torch.nn.Module, *_: Any, **__: Any) -> None:
        super().__init__()
        self.module = module

    def forward(self, *args: Any, **kwargs: Any) -> Any:
        return self.module(*args, **kwargs)


def _always(value: Any = None) -> Callable[..., Any]:
    return lambda *_, **__: value


def _cuda_names() -> dict[str, Any]:
    """Make the members of `torch.cuda` in the context, each distinct, because torch.compile distinguishes functions."""
    nothing = "init set_device synchronize empty_cache ipc_collect reset_peak_memory_stats reset_max_memory_allocated"
    counts = "memory_allocated max_memory_allocated memory_reserved max_memory_reserved utilization current_device"
    seeds = ("manual_seed", "manual_seed_all")
    kinds = ("Float", "Double", "Half", "Int", "Long", "Short", "Byte", "Bool")
    return {
        **{name: _always() for name in nothing.split()},
        **{name: _always(0) for name in counts.split()},
        **{name: _always(True) for name in ("is_available", "is_initialized")},
        **{name: lambda *_: contextlib.nullcontext() for name in ("device", "device_of")},
        **{name: lambda *_: _Stream() for name in ("current_stream", "default_stream")},
        **{name: lambda seed: torch.default_generator.manual_seed(int(seed)) for name in seeds},
        **{name: lambda: torch.default_generator.seed() for name in ("seed", "seed_all")},
        **{f"{kind}Tensor": getattr(torch, f"{kind}Tensor") for kind in kinds},
        "device_count": _always(1),
        "memory_summary": _always(""),
        "get_device_name": _always(_Properties.name),
        "get_device_properties": _always(_Properties()),
        "get_device_capability": _always((_Properties.major, _Properties.minor)),
        "mem_get_info": _always((_MEMORY, _MEMORY)),
        "get_rng_state": lambda *_: torch.get_rng_state(),
        "set_rng_state": lambda state, *_: torch.set_rng_state(state),
        "is_current_stream_capturing": _always(False),
        "Stream": _Stream,
        "stream": lambda stream: stream or contextlib.nullcontext(),
        "Event": _Event,
    }


def _replaced() -> list[tuple[Any, str, Any]]:
    """List the replacements: (module, name, value)."""
    load, run_backward = torch.load, private.find(private.ENGINE)
    set_device, set_type = torch.set_default_device, torch.set_default_tensor_type
    move = torch.nn.Module.to

    def load_here(file: Any, map_location: Any = None, *args: Any, **kwargs: Any) -> Any:
        return load(file, map_location if callable(map_location) else _CPU, *args, **kwargs)

    def backward(*args: Any, **kwargs: Any) -> Any:
        # The mode is off inside intercepted functions such as `Tensor.backward`, which call functions of the program.
        # A torch without this name leaves it off there.
        with _OnCPU():
            return run_backward(*args, **kwargs)

    def move_here(module: Any, *args: Any, **kwargs: Any) -> Any:
        named = {name: _number_on_cpu(value) for name, value in kwargs.items()}
        return move(module, *map(_number_on_cpu, args), **named)

    def script(function: Any = None, *_: Any, **__: Any) -> Any:
        # Compiled functions request devices where no mode intercepts it, so they are left unchanged.
        return script if function is None else function

    names: list[tuple[Any, str, Any]] = [(torch.cuda, name, value) for name, value in _cuda_names().items()]
    names += [(torch.cuda.nvtx, name, _always()) for name in ("range_push", "range_pop", "mark")]
    if run_backward is not None:
        names.append((torch.autograd, private.ENGINE.partition(":")[2], backward))
    return [
        *names,
        (torch, "Generator", _Generator),
        (torch, "load", load_here),
        (torch.UntypedStorage, "cuda", lambda storage, *_, **__: storage.clone()),
        (torch.jit, "script", script),
        (torch.nn.Module, "to", move_here),
        (torch.nn, "DataParallel", _DataParallel),
        (torch.Tensor, "record_stream", _always()),
        (torch, "set_default_device", lambda device: set_device(_on_cpu(device))),
        (torch, "set_default_tensor_type", lambda kind: set_type(_on_cpu(kind))),
    ]


@contextlib.contextmanager
def cuda_on_cpu(always: bool = False) -> Iterator[None]:
    """Let "cuda" mean the CPU inside the block, on a machine without CUDA.

    Tensors that are made on, or moved to, a device of CUDA are made on the CPU, and `torch.cuda` reports one device. A
    move copies, as between devices, unless the tensor requires gradients. ``tensor.device`` is the CPU, with index 0. A
    line on standard error reports the replacement.

    Args:
        always: Whether to replace on a machine with CUDA, too.

    Returns:
        Context manager. It concerns the thread that enters it.

    Example:
        >>> with cuda_on_cpu():
        ...     positions = torch.zeros(4, 3, device="cuda")
        ...     torch.cuda.synchronize()
    """
    if has_cuda() and not always:
        yield
        return
    sys.stderr.write("neural-renderer: what the program asks of CUDA happens on the CPU\n")
    before = []
    try:
        for module, name, value in _replaced():
            before.append((module, name, getattr(module, name)))
            setattr(module, name, value)
        with _OnCPU():
            yield
    finally:
        for module, name, value in reversed(before):
            setattr(module, name, value)
