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


# Whether a transformation of `torch.func` is active; True if it may be.
transforms_active: Callable[[], bool] = find(TRANSFORMS) or (lambda: True)

# The number of modes, such as those that trace, that see calls of operators; 1 if there may be one.
dispatch_modes: Callable[[], int] = find(DISPATCH_MODES) or (lambda: 1)

if _all(TRANSFORMS):

    def may_be_read(tensor: Tensor) -> bool:
        """Test whether no transformation of `torch.func` hides the values of a tensor, or of what is computed of it."""
        return not transforms_active()
else:

    def may_be_read(tensor: Tensor) -> bool:
        """Test whether no transformation of `torch.func` hides the values of a tensor, or of what is computed of it."""
        result = tensor.view_as(tensor)
        return torch.func.debug_unwrap(result) is result


# A saved tensor of a `torch.func` transformation that has ended, without its wrapper.
unwrap_dead: Callable[[Tensor], Tensor] = find(UNWRAP_DEAD) or (lambda tensor: tensor.clone())

# A context in which wrappers of `torch.func` are ignored.
without_transforms: Callable[[], Any] = find(DISABLE) or contextlib.nullcontext


if _all(FORWARD_LEVEL):

    def may_have_tangents() -> bool:
        """Test whether a level of forward mode is entered, or may be."""
        return forward_ad._current_level >= 0
else:

    def may_have_tangents() -> bool:
        """Test whether a level of forward mode is entered, or may be."""
        return True


if _all(EXCLUDED, AUTOGRAD_KEY):

    def records_derivatives() -> bool:
        """Test whether derivatives are recorded, or may be: not inside an operator, nor in inference mode."""
        return not torch._C._dispatch_tls_is_dispatch_key_excluded(torch._C.DispatchKey.AutogradFunctionality)
else:

    def records_derivatives() -> bool:
        """Test whether derivatives are recorded, or may be."""
        return True


if _all(*WRAPPERS, UNWRAP, DISABLE):

    def unwrapped(tensor: Tensor) -> Tensor | None:
        """Remove one wrapper of `torch.func`; returns a plain tensor as it is, and None for a batched one."""
        functorch = torch._C._functorch
        if not functorch.is_functorch_wrapped_tensor(tensor):
            return tensor
        return None if functorch.is_batchedtensor(tensor) else functorch.get_unwrapped(tensor)
else:

    def unwrapped(tensor: Tensor) -> Tensor | None:
        """Return a tensor as it is; None if it may be wrapped."""
        return None if transforms_active() else tensor


if _all(VERSION):

    def version_of(*tensors: Tensor) -> tuple[int, ...] | None:
        """Return the counters of in-place changes, by which a cache sees that its tensors have other values.

        None if a tensor has no counter, as in inference mode: then nothing may be cached.
        """
        return None if any(each.is_inference() for each in tensors) else tuple(each._version for each in tensors)
else:

    def version_of(*tensors: Tensor) -> tuple[int, ...] | None:
        """Return None: nothing may be cached."""
        return None


def base_of(tensor: Tensor) -> Tensor:
    """Return the tensor of which this one is a view; an indexed tensor is a new one in every call."""
    base: Tensor | None = tensor._base if _has_base else None
    return tensor if base is None else base


_has_base = _all(BASE)

if _all(MODES, DEVICE_CONTEXT):
    from torch.overrides import _get_current_function_mode_stack
    from torch.utils._device import DeviceContext

    def default_device() -> torch.device | None:
        """Return torch's default device, if one is set."""
        chosen = [mode.device for mode in _get_current_function_mode_stack() if isinstance(mode, DeviceContext)]
        return chosen[-1] if chosen else None
else:

    def default_device() -> torch.device | None:
        """Return torch's default device, if one is set that is not the CPU: torch returns the CPU where none is."""
        chosen = torch.get_default_device()
        return None if chosen.type == "cpu" else chosen


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
