"""Running Warp kernels on torch tensors: devices, streams and CPU threads.

Warp runs a CPU kernel as a plain loop on the calling thread, without the GIL. Every kernel here therefore takes the
number of its first task as its first argument, and `launch` distributes the task range over several threads. No two
tasks write to the same address, so the result does not depend on the number of threads.
"""

from __future__ import annotations

import contextlib
import ctypes
import itertools
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache, partial
from typing import Any

import torch
import warp as wp

from ...base import private
from ...base.recording import recorder
from .kernel_cache import load_module
from .layout import PIECES, pixel_tasks, worth_a_thread
from .native import BACKWARD, FOR_CUDA, Call, call_of, short_headers

_COMPILERS = 4  # compiling threads, at most

# torch's own function, before `cuda_on_cpu` replaces it.
has_cuda = torch.cuda.is_available

# Set by tests: a function of the kernel, the number of tasks and the arguments of each launch. It returns True if it
# has run the kernel's CUDA code on the CPU; if it returns False, the launch runs as usual.
emulator: Callable[[Any, int, Sequence[Any]], bool] | None = None

_lock = threading.Lock()
_ready: set[tuple[Any, str]] = set()
_asked: set[tuple[Any, torch.device, bool]] = set()  # earlier arguments of `load_ahead`
_pool: ThreadPoolExecutor | None = None
_pool_size = 0
_entries: dict[Any, Callable[..., None]] = {}
_on_cuda: dict[tuple[Any, int], Callable[..., None]] = {}  # entry points by kernel and index of the GPU


def _after_fork() -> None:
    # A forked child lacks its parent's threads, and may hold a lock that is never released. OpenMP does not restart its
    # threads, so torch would wait for them forever. The child therefore uses one thread, like torch's data loading.
    global _pool, _lock
    _pool, _lock = None, threading.Lock()
    if _ready:
        torch.set_num_threads(1)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    # Without a CUDA driver, Warp writes to stderr that CUDA is not available, in every process; CPU users know this.
    if has_cuda():
        yield
        return
    with open(os.devnull, "w") as null:
        stderr = os.dup(2)
        try:
            os.dup2(null.fileno(), 2)
            yield
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)


def load_kernel(kernel: wp.Kernel, device: str) -> None:
    """Compile and load the kernel's module once, before any thread needs it."""
    if (kernel, device) not in _ready:
        _load([kernel], device)


def load_ahead(functions: tuple[Callable[..., Any], ...], device: torch.device, backward: bool = False) -> None:
    """Compile and load the modules of these functions in parallel; with ``backward`` also those of gradients.

    Otherwise each module is compiled when one of its kernels first runs.
    """
    if (functions, device, backward) in _asked or emulator is not None or device.type not in ("cpu", "cuda"):
        return
    ends = ("", BACKWARD) if backward else ("",)
    names = {function.__module__: None for function in functions}
    modules = [wp.get_module(name + end) for end in ends for name in names]
    if device.type == "cuda":
        modules += [wp.get_module(one.name + FOR_CUDA) for one in modules]
    kernels = [next(iter(module.kernels.values())) for module in modules if module.kernels]
    name = "cpu" if device.type == "cpu" else str(device)  # Warp numbers no processors
    _load([kernel for kernel in kernels if (kernel, name) not in _ready], name)
    _asked.add((functions, device, backward))


def _load(kernels: Sequence[wp.Kernel], device: str) -> None:
    with _lock:
        level = wp.config.log_level
        wp.config.log_level = max(level, wp.LOG_WARNING)  # no banner and no build lines in a program's output
        try:
            with _quiet():
                wp.init()
            for module in {kernel.module for kernel in kernels if isinstance(kernel.module, wp.Module)}:
                _set_flags(module)
            if len(kernels) == 1:
                load_module(kernels[0], device)
            elif kernels:
                with ThreadPoolExecutor(min(len(kernels), os.cpu_count() or 1, _COMPILERS)) as pool:
                    list(pool.map(lambda kernel: load_module(kernel, device), kernels))
        except OSError as error:
            raise OSError(
                f"{wp.config.kernel_cache_dir}: expected a folder to keep compiled kernels in, got: {error}; "
                "set WARP_CACHE_PATH to another one"
            ) from error
        finally:
            wp.config.log_level = level
        _ready.update((kernel, device) for kernel in kernels)


def _set_flags(module: wp.Module) -> None:
    if module.options["cpu_compiler_flags"] is None:
        flags = f"{wp.config.cpu_compiler_flags or '-march=native'} {short_headers(module)}"
        wp.set_module_options({"cpu_compiler_flags": flags}, module)


def _threads(count: int) -> ThreadPoolExecutor:
    global _pool, _pool_size
    with _lock:
        if _pool is None or _pool_size < count:
            _pool, _pool_size = ThreadPoolExecutor(count, thread_name_prefix="neural_renderer"), count
        return _pool


def stream_of(device: torch.device) -> int | None:
    """Return the current stream; None while kernels are captured for a graph and do not run."""
    if device.type != "cuda" or emulator is not None:
        return 0
    return None if torch.cuda.is_current_stream_capturing() else torch.cuda.current_stream(device).cuda_stream


def launch(kernel: wp.Kernel, tasks: int, arguments: Sequence[Any], device: torch.device, least: int = 1) -> None:
    """Run ``kernel(first, *arguments)`` for a range of tasks, from number ``first`` plus its thread index.

    ``least`` is the number of tasks that justifies another CPU thread.
    """
    if tasks and (recording := recorder()):
        recording.launch(kernel, tasks, arguments, device, least)
    if tasks == 0 or (emulator is not None and emulator(kernel, tasks, [0, *arguments])):
        return
    if device.type == "cuda":
        index = torch.cuda.current_device() if device.index is None else device.index
        start = _on_cuda.get((kernel, index)) or _enter_on_cuda(kernel, index)
        start(tasks, *arguments)
        return
    entry = _entries.get(kernel) or _enter(kernel)
    if tasks < 2 * least or torch.get_num_threads() == 1:
        entry(tasks, 0, *arguments)
    else:
        share(lambda first, last: entry(last - first, first, *arguments), tasks, least)


def prepared(kernel: wp.Kernel, tasks: int, call: Call, device: torch.device, least: int) -> Callable[[], None]:
    """Return a function that launches a kernel as `launch`, with what ``call`` holds then.

    The eight bytes before ``call`` are 0, the number of the first task.
    """
    bound = getattr(_entries.get(kernel), "bound", None)
    if bound is None or emulator is not None or not (tasks < 2 * least or torch.get_num_threads() == 1):
        return partial(launch, kernel, tasks, (call,), device, least)
    found: Callable[[], None] = bound(tasks, call)
    return found


def launch_pixels(
    kernel: wp.Kernel, call: type[Call], rows: int, width: int, device: torch.device, /, **fields: Any
) -> None:
    """Launch a kernel on rows of pixels; the field ``each`` of its struct is the number of rows of a task."""
    tasks, each = pixel_tasks(rows, width, device)
    launch(kernel, tasks, [call(each=each, **fields)], device, worth_a_thread(each * width))


def _enter(kernel: wp.Kernel) -> Callable[..., None]:
    """Load a kernel for the CPU; return the function of tasks and arguments that runs it."""
    load_kernel(kernel, "cpu")

    def run(tasks: int, *arguments: Any) -> None:
        wp.launch(kernel, tasks, arguments, device="cpu", record_tape=False)

    _entries[kernel] = _direct(kernel) or run
    return _entries[kernel]


def _direct(kernel: wp.Kernel) -> Callable[..., None] | None:
    """Load a kernel as `_enter`, but call its compiled code: Warp's checks take longer than a small scene.

    None for kernels that are not C++, and if Warp does not show the compiled code.
    """
    struct = call_of(kernel)
    found = None if struct is None else private.compiled(kernel)
    if found is None:
        return None
    module, run_tasks, bounds_type = found
    packed = type("Arguments", (ctypes.Structure,), {"_fields_": [("first", ctypes.c_int32), ("call", struct)]})
    bounds = lru_cache(maxsize=64)(bounds_type)  # cached, because kernels only read them

    def run(tasks: int, first: int, call: Call, loaded: Any = module) -> None:  # keeps the module loaded
        run_tasks(ctypes.byref(bounds(tasks)), ctypes.byref(packed(first, call)))

    def bound(tasks: int, call: Call) -> Callable[[], None]:
        before = packed.from_address(ctypes.addressof(call) - packed.call.offset)  # type: ignore[attr-defined]
        return partial(run_tasks, ctypes.byref(bounds(tasks)), ctypes.byref(before))

    run.bound = bound  # type: ignore[attr-defined]
    return run


def _enter_on_cuda(kernel: wp.Kernel, index: int) -> Callable[..., None]:
    """Load a kernel on a GPU; return the function of tasks and arguments that starts it on torch's current stream."""
    with torch.cuda.device(index):
        load_kernel(kernel, f"cuda:{index}")

    def run(tasks: int, *arguments: Any) -> None:
        with torch.cuda.device(index):
            stream = wp.stream_from_torch(torch.cuda.current_stream())
            wp.launch(kernel, tasks, [0, *arguments], stream=stream, record_tape=False)

    _on_cuda[kernel, index] = _direct_on_cuda(kernel, index, run) or run
    return _on_cuda[kernel, index]


def _direct_on_cuda(kernel: wp.Kernel, index: int, otherwise: Callable[..., None]) -> Callable[..., None] | None:
    """Start a kernel by Warp's library, as `_direct`: Warp's Python takes longer than most kernels.

    ``otherwise`` starts it by Warp, whose errors say more. None as in `_direct`.
    """
    found = None if call_of(kernel) is None else private.compiled_on_cuda(kernel, f"cuda:{index}")
    if found is None:
        return None
    _, bounds_type, start, before, after = found
    bounds = lru_cache(maxsize=64)(bounds_type)
    first, current_stream = ctypes.c_int32(0), private.cuda_stream()
    at_first, addresses, address = ctypes.addressof(first), ctypes.c_void_p * 3, ctypes.addressof

    def run(tasks: int, call: Call, kept: Any = (found, first)) -> None:
        bound = bounds(tasks)
        arguments = addresses(address(bound), at_first, address(call))
        if start(*before, tasks, *after, arguments, current_stream(index), None):
            otherwise(tasks, call)

    return run


def share(run: Callable[[int, int], object], tasks: int, least: int) -> None:
    """Call run(first, last) for pieces of the tasks on as many CPU threads as torch uses."""
    threads = min(torch.get_num_threads(), max(1, tasks // least))
    pieces = min(tasks, PIECES * threads) if threads > 1 else 1
    numbers = itertools.count()

    def work() -> None:
        # next() on a count is atomic, so each piece is taken once, by the next free thread.
        while (piece := next(numbers)) < pieces:
            run(tasks * piece // pieces, tasks * (piece + 1) // pieces)

    others = [_threads(threads - 1).submit(work) for _ in range(threads - 1)]
    work()
    for other in others:
        if not other.cancel():  # if other callers keep the pool busy, this thread has done all pieces
            other.result()
