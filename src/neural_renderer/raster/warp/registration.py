"""Registering a Python function as a torch operator."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Any, NoReturn, ParamSpec, TypeVar, cast

import torch
from torch import Tensor, nn
from torch.autograd import forward_ad

_PLAIN = (Tensor, nn.Parameter)

P = ParamSpec("P")
R = TypeVar("R")


def operator(function: Callable[P, R]) -> Callable[P, R]:
    """Register the annotated function as the operator ``neural_renderer::<its name>``, opaque to torch.compile.

    `torch.library.custom_op` does the same, but its first call imports torch's compiler, over a second in each process.
    Plain tensors bypass torch's dispatcher, which takes longer than drawing a small scene: `differentiable` puts the
    function itself into torch's graph.

    Raises:
        RuntimeError: In a call, for derivatives in forward mode. torch would silently treat them as zero.
    """
    name = f"neural_renderer::{function.__name__}"
    torch.library.define(name, torch.library.infer_schema(function, mutates_args=()))
    torch.library.impl(name, "default", function)
    registered = getattr(torch.ops.neural_renderer, function.__name__).default

    plain: Callable[..., Any] = function
    graph: list[Any] = []  # two `torch.autograd.Function`, set by `differentiable`; the second one for torch.func
    defaults = tuple(parameter.default for parameter in inspect.signature(function).parameters.values())

    @functools.wraps(function)
    def call(*inputs: Any) -> Any:
        if not torch.compiler.is_compiling() and forward_ad._current_level >= 0:
            _refuse_tangents(function.__name__, inputs)
        if not is_plain(inputs):
            if graph and torch._C._are_functorch_transforms_active() and not torch.compiler.is_compiling():
                return graph[1].apply(*inputs, *defaults[len(inputs) :])
            return registered(*inputs)
        inputs += defaults[len(inputs) :]
        if not torch.is_grad_enabled() or not any(map(_requires_grad, inputs)):
            return plain(*inputs)
        if graph:
            return graph[0].apply(*inputs)
        with torch.no_grad():
            return plain(*inputs)

    torch.library.register_vmap(name, functools.partial(_one_by_one, call))
    call.operator = registered  # type: ignore[attr-defined]
    call.graph = graph  # type: ignore[attr-defined]
    return cast("Callable[P, R]", call)


def fake(call: Any) -> Callable[[Callable[..., R]], Callable[..., R]]:
    """Register the function that tells torch.compile the shapes of an `operator`'s results.

    It names those of the operator's arguments that it needs.
    """
    signature = inspect.signature(call)

    def register(shapes: Callable[..., R]) -> Callable[..., R]:
        needed = inspect.signature(shapes).parameters

        def of_inputs(*inputs: Any, **named: Any) -> R:
            given = signature.bind(*inputs, **named)
            given.apply_defaults()
            return shapes(**{name: given.arguments[name] for name in needed})

        torch.library.register_fake(f"neural_renderer::{call.__name__}", of_inputs)
        return shapes

    return register


def differentiable(call: Any, backward: Callable[..., Any], setup_context: Callable[..., Any] | None = None) -> None:
    """Give an `operator` its gradient, with functions as `torch.library.register_autograd` takes them."""
    name = call.__name__
    torch.library.register_autograd(f"neural_renderer::{name}", backward, setup_context=setup_context)

    def forward(ctx: Any, *inputs: Any) -> Any:
        output = call.__wrapped__(*inputs)
        if setup_context is not None:
            setup_context(ctx, inputs, output)
        return output

    methods = {"forward": staticmethod(forward), "backward": staticmethod(backward)}
    # The rules of `torch.func` need a forward pass without a context.
    separate = {
        "forward": staticmethod(lambda *inputs: call.__wrapped__(*inputs)),
        "setup_context": staticmethod(setup_context or (lambda ctx, inputs, output: None)),
        "backward": staticmethod(backward),
        "jvp": staticmethod(functools.partial(_refuse_forward_mode, name)),
        "vmap": staticmethod(functools.partial(_one_by_one, call)),
    }
    call.graph[:] = [type(name, (torch.autograd.Function,), part) for part in (methods, separate)]


def differentiable_once(function: Callable[P, R]) -> Callable[P, R]:
    """Register the operator that computes a gradient; its own gradient is an error (RuntimeError)."""
    backward = operator(function)
    differentiable(backward, lambda ctx, *grads: refuse_second(function.__name__))
    return backward


def refuse_second(name: str) -> NoReturn:
    """Raise RuntimeError: operator ``name`` cannot compute a second derivative."""
    raise RuntimeError(
        f"{name}: the rasteriser has first derivatives only where faces move, got a second one to compute; textures, "
        "attributes and lights have more if vertices and cameras need no gradient (detach them)"
    )


def _one_by_one(call: Any, info: Any, in_dims: tuple[int | None, ...], *inputs: Any) -> Any:
    """Run an operator for each element of the dimension that `torch.func.vmap` adds, and stack the results in front."""
    results = []
    for n in range(info.batch_size):
        own = (value if dim is None else value.select(dim, n) for value, dim in zip(inputs, in_dims, strict=True))
        results.append(call(*own))
    if isinstance(results[0], Tensor):
        return torch.stack(results), 0
    stacked = tuple(torch.stack(parts) for parts in zip(*results, strict=True))
    return stacked, (0,) * len(stacked)


def is_plain(inputs: tuple[Any, ...]) -> bool:
    """Test whether all tensors are plain ones with memory, and no tracing or transformation is active.

    A lazily negated view is not plain: its memory holds other values.
    """
    if (
        torch.compiler.is_compiling()
        or torch._C._len_torch_dispatch_stack()
        or torch._C._are_functorch_transforms_active()
    ):
        return False
    for value in inputs:
        if isinstance(value, Tensor) and (type(value) not in _PLAIN or value.is_meta or value.is_neg()):
            return False
    return True


def needs_gradient(*tensors: Tensor) -> bool:
    """Test whether a gradient to one of the tensors may be asked for.

    Inside a transformation of `torch.func` a tensor does not tell, so the answer is yes.
    """
    if not torch.is_grad_enabled():
        return False
    return torch._C._are_functorch_transforms_active() or any(tensor.requires_grad for tensor in tensors)


def _requires_grad(value: Any) -> bool:
    return isinstance(value, Tensor) and value.requires_grad


def _refuse_tangents(name: str, inputs: tuple[Any, ...]) -> None:
    for value in inputs:
        if isinstance(value, Tensor) and forward_ad.unpack_dual(value).tangent is not None:
            _refuse_forward_mode(name)


def _refuse_forward_mode(name: str, *_: Any) -> NoReturn:
    raise RuntimeError(
        f"{name}: expected tensors without tangents, got one to differentiate in forward mode; the rasteriser "
        "has gradients in reverse mode only (backward)"
    )
