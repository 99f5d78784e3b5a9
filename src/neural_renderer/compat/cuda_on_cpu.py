"""Programs that say "cuda", on a machine without CUDA: a context in which it means the CPU.

Calls of torch's functions pass through a mode, which replaces the device. Names that no mode sees, such as
`torch.cuda.synchronize`, are replaced in their modules as long as the context lasts.
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

from ..raster.warp.launch import has_cuda

_CPU = torch.device("cpu")
_MEMORY = 8 << 30  # bytes that the device claims to have
_MAKES_VIEWS = (torch.as_tensor, torch.asarray)  # of memory that the caller may go on to use


class _OnCPU(TorchFunctionMode):
    """Replaces devices of CUDA in calls of torch's functions."""

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        if kwargs.get("pin_memory"):  # memory that CUDA copies from faster
            kwargs["pin_memory"] = False
        if func in (Tensor.cuda, Tensor.cpu):
            return _copied(args[0])
        if func is Tensor.pin_memory:
            return args[0]
        if func is torch.device or not any(map(_is_cuda, (*args, *kwargs.values()))):
            result = func(*args, **kwargs)
            stays = func is Tensor.to and result is args[0]
            named = any(isinstance(value, (str, torch.device)) for value in (*args[1:], *kwargs.values()))
            return _copied(result) if stays and named else result  # a call that names a device moves a tensor
        result = func(*map(_here, args), **{name: _here(value) for name, value in kwargs.items()})
        shares = func in _MAKES_VIEWS or (func is Tensor.to and result is args[0])
        return _copied(result) if shares else result


def _copied(tensor: Tensor) -> Tensor:
    """Copy a tensor as a move between devices does; one with a gradient stays, because it may be a leaf."""
    return tensor if tensor.requires_grad else tensor.clone()


def _is_cuda(value: Any) -> bool:
    if isinstance(value, torch.device):
        return value.type == "cuda"
    return isinstance(value, str) and (value == "cuda" or value.startswith(("cuda:", "torch.cuda.")))


def _here(value: Any) -> Any:
    """Return the CPU for a device of CUDA, and a type of tensors of the CPU for one of CUDA; else the value."""
    if not _is_cuda(value):
        return value
    return value.replace("torch.cuda.", "torch.") if str(value).startswith("torch.") else _CPU


class _Generator(torch.Generator):
    """`torch.Generator`, which takes "cuda" as the CPU."""

    def __new__(cls, device: Any = "cpu") -> Any:
        return torch._C.Generator.__new__(cls, _here(device))  # type: ignore[call-arg]


class _Stream:
    """A stream: work on the CPU is done when a call returns."""

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
    """An event: the time at which it was recorded."""

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
    """What `torch.cuda.get_device_properties` tells."""

    name, major, minor, total_memory, multi_processor_count = "CPU", 8, 0, _MEMORY, 1


def _always(value: Any = None) -> Callable[..., Any]:
    return lambda *_, **__: value


def _cuda_names() -> dict[str, Any]:
    """Make what stands in `torch.cuda` inside the context. torch.compile tells functions apart: none is there twice."""
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
    """List what is replaced: (module, name, value)."""
    load, run_backward = torch.load, torch.autograd._engine_run_backward  # type: ignore[attr-defined]
    set_device, set_type = torch.set_default_device, torch.set_default_tensor_type

    def load_here(file: Any, map_location: Any = None, *args: Any, **kwargs: Any) -> Any:
        return load(file, map_location if callable(map_location) else _CPU, *args, **kwargs)

    def backward(*args: Any, **kwargs: Any) -> Any:
        # The mode is off inside the functions that it sees, `Tensor.backward` among them; functions that a program
        # defines run in there.
        with _OnCPU():
            return run_backward(*args, **kwargs)

    def script(function: Any = None, *_: Any, **__: Any) -> Any:
        # Its compiled functions ask for devices where no mode hears it, so they stay as they are.
        return script if function is None else function

    names: list[tuple[Any, str, Any]] = [(torch.cuda, name, value) for name, value in _cuda_names().items()]
    names += [(torch.cuda.nvtx, name, _always()) for name in ("range_push", "range_pop", "mark")]
    return [
        *names,
        (torch, "Generator", _Generator),
        (torch, "load", load_here),
        (torch.UntypedStorage, "cuda", lambda storage, *_, **__: storage.clone()),
        (torch.jit, "script", script),
        (torch, "set_default_device", lambda device: set_device(_here(device))),
        (torch, "set_default_tensor_type", lambda kind: set_type(_here(kind))),
        (torch.autograd, "_engine_run_backward", backward),
    ]


@contextlib.contextmanager
def cuda_on_cpu(always: bool = False) -> Iterator[None]:
    """Let a program's "cuda" mean the CPU inside the block, on a machine without CUDA.

    Tensors that are made on, or moved to, a device of CUDA are made on the CPU, and `torch.cuda` answers as if there
    were one device. A move is a copy, as between devices, unless the tensor has a gradient. What a tensor tells of its
    device remains the truth. One line on standard error says so.

    Args:
        always: Whether to do so on a machine with CUDA, too.

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
