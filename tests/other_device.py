"""A stand-in for a device without kernels, such as Apple's "mps": its tensors are torch's own, on the device "other".

Their numbers lie in tensors on the CPU, and operations on them run there; they mix with tensors of no other device.
Like "mps", it has no float64. torch has one device of this kind, which lasts for the rest of a process.
"""

from __future__ import annotations

import functools
from typing import Any

import torch
from torch import Tensor
from torch.utils import backend_registration
from torch.utils._pytree import tree_leaves, tree_map

NAME = "other"
# Operations with a kernel for these are run by torch itself, in parts that share memory; here each is one operation.
_IN_PARTS = ("CompositeExplicitAutograd", "CompositeExplicitAutogradNonFunctional")

_numbers: dict[int, Tensor] = {}  # on the CPU, by the storage of an "other" tensor
_libraries: list[torch.library.Library] = []


def available() -> bool:
    """Test whether this torch makes devices from Python."""
    return hasattr(backend_registration, "_setup_privateuseone_for_python_backend")


def register() -> None:
    """Make the device: ``torch.ones(3, device="other")`` works then."""
    backend_registration._setup_privateuseone_for_python_backend(NAME, _Module())
    rest, aten = torch.library.Library("_", "IMPL"), torch.library.Library("aten", "IMPL")
    rest.fallback(_run, "PrivateUse1")
    _libraries.extend((rest, aten))
    for name in torch._C._dispatch_get_all_op_names():
        packet, _, overload = name.removeprefix("aten::").partition(".")
        operation = getattr(getattr(torch.ops.aten, packet, None), overload or "default", None)
        in_parts = any(torch._C._dispatch_has_kernel_for_dispatch_key(name, key) for key in _IN_PARTS)
        if name.startswith("aten::") and operation is not None and in_parts:
            aten.impl(name.removeprefix("aten::"), functools.partial(_run, operation), "PrivateUse1")


class _Module(getattr(backend_registration, "_DummyBackendModule", object)):  # type: ignore[misc]
    """The functions of ``torch.other``."""

    def get_amp_supported_dtype(self) -> list[torch.dtype]:
        return []


def is_other(value: Any) -> bool:
    return isinstance(value, Tensor) and value.device.type == NAME


def _run(operation: Any, *args: Any, **kwargs: Any) -> Any:
    """Run an operation on the numbers."""
    given = [each for each in tree_leaves((args, kwargs)) if isinstance(each, Tensor)]
    if operation._schema.name.startswith("aten::_copy_from"):
        _inner(args[1]).copy_(_inner(args[0]))
        return args[1]
    moves = operation._schema.name in ("aten::copy_", "aten::_to_copy")
    assert moves or all(is_other(each) or each.dim() == 0 for each in given), f"{operation}: tensors of two devices"
    if operation is torch.ops.aten.view.default:  # the numbers of a permuted tensor lie in another order
        operation = torch.ops.aten.reshape.default
    results = operation(*tree_map(_inner, args), **tree_map(_inner, kwargs))
    known = [each for each in given if is_other(each)]
    for each in known:
        if each.shape != _inner(each).shape:  # a result that the caller gave
            each.data = _outer(_inner(each), [])
    if torch.device(kwargs.get("device") or NAME).type != NAME:
        return results
    return tree_map(lambda value: _outer(value, known) if isinstance(value, Tensor) else value, results)


def _inner(value: Any) -> Any:
    if is_other(value):
        return _numbers[value.untyped_storage()._cdata]
    return torch.device("cpu") if isinstance(value, torch.device) and value.type == NAME else value


def _outer(numbers: Tensor, known: list[Tensor]) -> Tensor:
    """Make the "other" tensor of numbers, unless one of those known is it."""
    for each in known:
        if _inner(each) is numbers:
            return each
    if numbers.dtype == torch.float64:
        raise TypeError('the device "other" has no float64')
    made = torch._C._acc.create_empty_tensor(numbers.shape, numbers.dtype)
    _numbers[made.untyped_storage()._cdata] = numbers
    return made
