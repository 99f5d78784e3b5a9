"""The private names of torch and Warp that the package uses, each with a slower public way for versions without it.

No other file has one. Other modules call these functions as ``private.name()``. Their results are the same without a
private name: a tensor then counts as perhaps transformed, traced, differentiated or changed, and takes torch's own
dispatcher; Warp launches kernels itself, and its cache is not repaired. `tests/base/test_private.py` fails first where
a name is missing.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from torch import Tensor
from torch.autograd import forward_ad

if TYPE_CHECKING:
    import warp as wp

# "module:name", as `find` takes them.
TRANSFORMS = "torch:_C._are_functorch_transforms_active"
DISPATCH_MODES = "torch:_C._len_torch_dispatch_stack"
DISPATCH_MODE = "torch.utils._python_dispatch:TorchDispatchMode"
INNERMOST = "torch.utils._python_dispatch:_get_current_dispatch_mode"
FUNCTION_MODES = "torch:_C._len_torch_function_stack"
PACKING = "torch:_C._autograd._top_saved_tensors_default_hooks"
EXCLUDED = "torch:_C._dispatch_tls_is_dispatch_key_excluded"
AUTOGRAD_KEY = "torch:_C.DispatchKey.AutogradFunctionality"
FORWARD_LEVEL = "torch.autograd.forward_ad:_current_level"
UNWRAP_DEAD = "torch:_C._functorch.unwrap_if_dead"
WRAPPERS = tuple(f"torch:_C._functorch.{name}" for name in ("is_functorch_wrapped_tensor", "is_batchedtensor"))
UNWRAP = "torch:_C._functorch.get_unwrapped"
DISABLE = "torch:_C._DisableFuncTorch"
MODES = "torch.overrides:_get_current_function_mode_stack"
DEVICE_CONTEXT = "torch.utils._device:DeviceContext"
VERSION = "torch:Tensor._version"
BASE = "torch:Tensor._base"
ENGINE = "torch.autograd:_engine_run_backward"
BOUNDS = "warp._src.types:launch_bounds_t"
HOOKS = "warp._src.context:ModuleExec.get_kernel_hooks"
IDENTIFIER = "warp._src.context:Module.get_module_identifier"
STREAM = "torch:_C._cuda_getCurrentRawStream"  # where torch is built for CUDA

NAMES = (
    *(TRANSFORMS, DISPATCH_MODES, EXCLUDED, AUTOGRAD_KEY, FORWARD_LEVEL, UNWRAP_DEAD, *WRAPPERS, UNWRAP, DISABLE),
    *(DISPATCH_MODE, INNERMOST, FUNCTION_MODES, PACKING),
    *(MODES, DEVICE_CONTEXT, VERSION, BASE, ENGINE, BOUNDS, HOOKS, IDENTIFIER, STREAM),
)

# Warp versions whose compiled kernels have the arguments that `compiled` passes.
_KNOWN_WARP = ("1.19.",)


def find(path: str) -> Any:
    """Find an object by "module:name"; None if there is none."""
    module, name = path.split(":")
    try:
        found = import_module(module)
        for part in name.split("."):
            found = getattr(found, part)
    except (ImportError, AttributeError):
        return None
    return found


def _all(*paths: str) -> bool:
    return all(find(path) is not None for path in paths)


_HAS_LEVEL, _HAS_VERSION, _HAS_BASE = map(_all, (FORWARD_LEVEL, VERSION, BASE))
_HAS_KEYS = _all(EXCLUDED, AUTOGRAD_KEY)
_KNOWS_TRANSFORMS, _UNWRAPS = _all(TRANSFORMS), _all(*WRAPPERS, UNWRAP, DISABLE)
_modes, _context = find(MODES), find(DEVICE_CONTEXT)

# Whether a transformation of `torch.func` is active; True if unknown.
transforms_active: Callable[[], bool] = find(TRANSFORMS) or (lambda: True)

# The number of active dispatch modes, such as tracers; 1 if unknown.
dispatch_modes: Callable[[], int] = find(DISPATCH_MODES) or (lambda: 1)

# The base class of dispatch modes, and the innermost active one, None without one.
DispatchMode: Any = find(DISPATCH_MODE) or object
dispatch_mode: Callable[[], Any] = find(INNERMOST) or (lambda: None)

_function_modes = find(FUNCTION_MODES)
_packing = find(PACKING) if _all(DISPATCH_MODES, DISPATCH_MODE, INNERMOST, FUNCTION_MODES) else None

# A saved tensor of a `torch.func` transformation that has ended, without its wrapper.
unwrap_dead: Callable[[Tensor], Tensor] = find(UNWRAP_DEAD) or (lambda tensor: tensor.clone())

# A context in which wrappers of `torch.func` are ignored.
without_transforms: Callable[[], Any] = find(DISABLE) or contextlib.nullcontext


def may_record() -> bool:
    """Test whether a mode can record steps, and no other mode, autocast or `saved_tensors_hooks` are active."""
    return _packing is not None and _packing(False) is None and not (_function_modes() or torch.is_autocast_enabled())


def may_be_read(tensor: Tensor) -> bool:
    """Test whether the values of a tensor can be read: no transformation of `torch.func` wraps it or its results."""
    if _KNOWS_TRANSFORMS:
        return not transforms_active()
    result = tensor.view_as(tensor)
    return torch.func.debug_unwrap(result) is result


def may_have_tangents() -> bool:
    """Test whether a level of forward mode is entered, or may be."""
    return not _HAS_LEVEL or forward_ad._current_level >= 0


def records_derivatives() -> bool:
    """Test whether derivatives are recorded, or may be: not inside an operator, nor in inference mode."""
    excluded = torch._C._dispatch_tls_is_dispatch_key_excluded if _HAS_KEYS else None
    return excluded is None or not excluded(torch._C.DispatchKey.AutogradFunctionality)


def unwrapped(tensor: Tensor) -> Tensor | None:
    """Remove one wrapper of `torch.func`. Returns a plain tensor as it is, and None for one that may be batched."""
    if not _UNWRAPS:
        return None if transforms_active() else tensor
    functorch = torch._C._functorch
    if not functorch.is_functorch_wrapped_tensor(tensor):
        return tensor
    return None if functorch.is_batchedtensor(tensor) else functorch.get_unwrapped(tensor)


def version_of(*tensors: Tensor) -> tuple[int, ...] | None:
    """Return the counters of in-place changes, by which a cache sees that its tensors have other values.

    None if a tensor has no counter, as in inference mode: then nothing may be cached.
    """
    if not _HAS_VERSION or any(each.is_inference() for each in tensors):
        return None
    return tuple(each._version for each in tensors)


def base_of(tensor: Tensor) -> Tensor:
    """Return the tensor that this one is a view of, or itself. Indexing makes a new view in every call."""
    base: Tensor | None = tensor._base if _HAS_BASE else None
    return tensor if base is None else base


def default_device() -> torch.device | None:
    """Return torch's default device, if one is set; without private names, if it is not the CPU."""
    if _modes is None or _context is None:
        chosen = torch.get_default_device()  # the CPU where none is set
        return None if chosen.type == "cpu" else chosen
    devices = [mode.device for mode in _modes() if isinstance(mode, _context)]
    return devices[-1] if devices else None


def compiled(kernel: wp.Kernel) -> tuple[Any, Callable[..., None], type] | None:
    """Load a kernel for the CPU: its module, its compiled function, and the type of the bounds that this takes.

    None if only Warp can launch it.
    """
    if not _knows_warp():
        return None
    module: Any = kernel.module.load(find("warp:get_device")("cpu"), 1)
    return module, module.get_kernel_hooks(kernel).forward, find(BOUNDS)


def _knows_warp() -> bool:
    return str(find("warp:__version__")).startswith(_KNOWN_WARP) and _all(BOUNDS, HOOKS)


class OnCuda(NamedTuple):
    """A kernel that is loaded on a GPU, and how Warp's library starts it."""

    module: Any  # keeps the code loaded
    bounds: type  # of the struct of the number of tasks, the kernel's first argument
    start: Callable[..., int]  # start(*before, tasks, *after, arguments, stream, None); 0 if it started
    before: tuple[Any, ...]
    after: tuple[Any, ...]


_BLOCK = 256  # threads of a block, Warp's default


def compiled_on_cuda(kernel: wp.Kernel, device: str) -> OnCuda | None:
    """Load a kernel on a GPU; None if only Warp can launch it."""
    if not _knows_warp():
        return None
    on: Any = find("warp:get_device")(device)
    module: Any = kernel.module.load(on, _BLOCK)
    hooks = module.get_kernel_hooks(kernel)
    any_blocks, strided = 0, int(bool(kernel.grid_stride))
    after = (any_blocks, _BLOCK, strided, hooks.cluster_dim, hooks.forward_smem_bytes)
    return OnCuda(module, find(BOUNDS), on.runtime.core.wp_cuda_launch_kernel, (on.context, hooks.forward), after)


def cuda_stream() -> Callable[[int], int]:
    """Return a function that gives the current stream of a GPU, by its number."""
    return find(STREAM) or (lambda index: torch.cuda.current_stream(index).cuda_stream)


def is_loaded(kernel: wp.Kernel) -> bool:
    """Test whether a loaded module has its kernel: a damaged file may load without."""
    loaded = getattr(kernel.module, "execs", {}).values() if _all(HOOKS) else ()
    return all(each.get_kernel_hooks(kernel).forward is not None for each in loaded)


def identifier(module: wp.Module, device: str) -> str | None:
    """Return the name of a module's folder in the cache, for the CPU or CUDA; None if it is not known."""
    return module.get_module_identifier(1 if device == "cpu" else None) if _all(IDENTIFIER) else None
