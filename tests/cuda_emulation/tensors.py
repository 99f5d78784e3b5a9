"""Tensors that say they are on a GPU, with their numbers on the CPU; they count what would wait for the GPU.

A `GpuTensor` behaves like a tensor on CUDA: tensors on the CPU do not mix with it, reading a number is seen, dividing
by one rounds twice, and unless torch is deterministic, `index_add` sums in any order. Kernels have to be taken from
`launch`, as `EmulatedDevice` does.
"""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Callable
from typing import Any, ClassVar

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._pytree import tree_leaves, tree_map

from neural_renderer.base import arrivals

GPU = torch.device("cuda:0")
_WAITS = {"_local_scalar_dense", "nonzero", "masked_select", "equal", "is_nonzero", "_unique2", "unique_dim"}
_INDEXING = {"index", "index_put", "index_put_"}
_FROM_NUMBERS = (torch.tensor, torch.as_tensor, Tensor.new_tensor)


class GpuTensor(Tensor):
    """A tensor on the emulated GPU.

    Attributes:
        inner: Its numbers, on the CPU.
    """

    inner: Tensor
    __torch_function__ = torch._C._disabled_torch_function_impl
    device = property(lambda self: GPU)  # type: ignore[assignment]
    is_cuda = property(lambda self: True)  # type: ignore[assignment]

    @staticmethod
    def __new__(cls, inner: Tensor) -> GpuTensor:
        shape, strides, offset = inner.shape, inner.stride(), inner.storage_offset()
        result = Tensor._make_wrapper_subclass(  # type: ignore[attr-defined]
            cls, shape, strides=strides, storage_offset=offset, dtype=inner.dtype, device="cpu"
        )
        result.inner = inner
        return result

    def data_ptr(self) -> int:
        return self.inner.data_ptr()

    def __deepcopy__(self, memo: dict[int, Any]) -> GpuTensor:
        return GpuTensor(self.inner.clone()).requires_grad_(self.requires_grad)

    def __reduce_ex__(self, protocol: Any) -> Any:
        return GpuTensor, (self.inner.detach(),)

    @classmethod
    def __torch_dispatch__(cls, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        if function.namespace == "neural_renderer":  # the operator's own code, with the same eyes
            with Gpu.entered[-1].again():
                return _implementation(function)(*args, **kwargs)
        name = function._schema.name.removeprefix("aten::")
        counts = Gpu.entered[-1]
        counts.operators[name] += 1
        if name in _WAITS:
            counts.waits[name] += 1
        if name in _INDEXING:
            for index in args[1]:
                if index is None:
                    continue
                if index.dtype in (torch.bool, torch.uint8):
                    counts.waits["boolean index"] += 1
                elif not isinstance(index, GpuTensor):
                    counts.copies["index"] += 1
        elif name == "copy_" and isinstance(args[0], GpuTensor):
            counts.copies[name] += type(args[1]) is Tensor
        elif torch._C._current_graph_task_id() < 0 and any(  # in a backward pass torch itself makes zeros
            type(one) is Tensor and one.dim() for one in tree_leaves((args, kwargs))
        ):
            raise RuntimeError(f"{name}: expected tensors on the GPU, got one on the CPU")
        if "device" in kwargs:
            kwargs = {**kwargs, "device": "cpu"}
        by_number = name in ("div", "div_") and not kwargs and not isinstance(args[1], GpuTensor)
        if by_number and args[0].is_floating_point():  # torch multiplies by the reciprocal
            number = torch.as_tensor(args[1], dtype=args[0].dtype)
            function, args = getattr(torch.ops.aten, name.replace("div", "mul")).Tensor, (args[0], 1 / number)
        if name in ("index_add", "index_add_") and not torch.are_deterministic_algorithms_enabled():
            target, dim, index, source = args
            order = torch.randperm(len(index))
            args = target, dim, _inner(index)[order], _inner(source).index_select(dim, order)
        result = function(*tree_map(_inner, args), **tree_map(_inner, kwargs))
        if name.endswith("_") and not name.endswith("__") and isinstance(args[0], GpuTensor):
            return args[0]
        return tree_map(lambda one: GpuTensor(one) if isinstance(one, Tensor) else one, result)


class Gpu(TorchFunctionMode):
    """Makes new tensors on the emulated GPU where "cuda" is asked for, and counts while it is entered.

    Attributes:
        waits: Operations that wait for the GPU, such as reading a number, by name.
        copies: Copies from the CPU's memory by name; those of Python numbers among them.
        made: New tensors that torch allocates by name, without results of its operations.
        operators: Operations of torch by name, without new tensors.
        arrived: Whether numbers that are sent to the host have arrived.
    """

    entered: ClassVar[list[Gpu]] = []

    def __init__(self) -> None:
        super().__init__()
        self.waits: Counter[str] = Counter()
        self.copies: Counter[str] = Counter()
        self.made: Counter[str] = Counter()
        self.operators: Counter[str] = Counter()
        self.arrived = True

    def again(self) -> Gpu:
        """Make a mode for code inside an operator; it adds to the same counts."""
        inner = Gpu()
        inner.waits, inner.copies, inner.made, inner.operators = self.waits, self.copies, self.made, self.operators
        return inner

    def __enter__(self) -> Gpu:
        Gpu.entered.append(self)
        self._send, arrivals.send = arrivals.send, _send
        super().__enter__()
        return self

    def __exit__(self, *details: Any) -> None:
        super().__exit__(*details)
        arrivals.send = self._send
        Gpu.entered.pop()

    def __torch_function__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        mine = bool(args) and isinstance(args[0], GpuTensor)
        if function is Tensor.pin_memory:
            self.copies["pin_memory"] += 1
            return args[0]
        if function is Tensor.to or (function is torch.as_tensor and mine):
            return self._to(*args, **kwargs)
        if function is Tensor.cuda:
            return self._to(args[0], GPU)
        if function in (Tensor.cpu, Tensor.numpy, Tensor.tolist) and mine:
            self.waits[function.__name__] += 1
            return function(args[0].inner, *args[1:], **kwargs)
        wanted = kwargs.get("device")
        new = (wanted is not None and torch.device(wanted).type == "cuda") or (mine and function in _FROM_NUMBERS)
        if not new:
            return function(*args, **kwargs)
        if function in _FROM_NUMBERS:
            self.copies[function.__name__] += 1
        self.made[function.__name__] += 1
        if function is torch.empty:  # steps without kernels have to find numbers that are in range
            function = torch.zeros
        result = function(*map(_inner, args), **{**kwargs, "device": "cpu"})
        if isinstance(result, GpuTensor):
            return result
        return GpuTensor(result.detach()).requires_grad_(result.requires_grad)

    def _to(self, tensor: Tensor, *args: Any, **kwargs: Any) -> Tensor:
        if args and isinstance(args[0], Tensor):
            device, dtype = args[0].device, args[0].dtype
        else:
            kwargs.pop("copy", None)
            device, dtype, *_ = torch._C._nn._parse_to(*args, **kwargs)  # type: ignore[attr-defined]
        device, dtype = device or tensor.device, dtype or tensor.dtype
        if device.type == tensor.device.type:
            return tensor.to(dtype)
        if isinstance(tensor, GpuTensor):
            self.waits["to the CPU"] += 1
            return tensor.inner.to(dtype)
        self.copies["to the GPU"] += 1
        return _Move.apply(tensor.to(dtype))


class _Move(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, tensor: Tensor) -> GpuTensor:  # type: ignore[override]
        return GpuTensor(tensor.detach().clone())

    @staticmethod
    def backward(ctx: Any, grad: GpuTensor) -> Tensor:  # type: ignore[override]
        return grad.inner


def _send(number: Tensor) -> tuple[Tensor, Callable[[], bool]]:
    """Stand in for `arrivals.send`."""
    return _inner(number), lambda: all(one.arrived for one in Gpu.entered)


def _inner(value: Any) -> Any:
    return value.inner if isinstance(value, GpuTensor) else value


def _implementation(operator: Any) -> Callable[..., Any]:
    """Find the Python function that was registered as an operator."""
    name = operator._schema.name.partition("::")[2]
    for module in list(sys.modules.values()):
        found = getattr(module, name, None) if module.__name__.startswith("neural_renderer") else None
        if getattr(found, "operator", None) is operator:
            return found.__wrapped__
    raise LookupError(f"{name}: expected an operator of the package, found none")
