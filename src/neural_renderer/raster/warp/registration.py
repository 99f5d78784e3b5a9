"""Registering a Python function as a torch operator."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NoReturn, ParamSpec, TypeVar, cast

import torch
from torch import Tensor, nn
from torch.autograd import forward_ad

from ...base import private
from ...base.recording import recorder
from .elsewhere import check_devices, on_any_device, runs_kernels

_PLAIN = (Tensor, nn.Parameter)

P = ParamSpec("P")
R = TypeVar("R")


def operator(function: Callable[P, R]) -> Callable[P, R]:
    """Register the annotated function as the operator ``neural_renderer::<its name>``, opaque to torch.compile.

    `torch.library.custom_op` does the same, but its first call imports torch's compiler, over a second in each process.
    Plain tensors bypass torch's dispatcher, which takes longer than drawing a small scene: `differentiable` puts the
    function itself into torch's graph. Without `differentiable`, results have no derivatives.
    """
    return _registered(function, 0)


def _registered(function: Callable[P, R], directions: int) -> Callable[P, R]:
    name = f"neural_renderer::{function.__name__}"
    torch.library.define(name, torch.library.infer_schema(function, mutates_args=()))
    defaults = tuple(parameter.default for parameter in inspect.signature(function).parameters.values())
    torch.library.impl(name, "default", on_any_device(function))
    registered = getattr(torch.ops.neural_renderer, function.__name__).default

    plain: Callable[..., Any] = function
    # Two subclasses of `torch.autograd.Function`, set by `differentiable`; the second for torch.func.
    graph: list[Any] = []

    @functools.wraps(function)
    def call(*inputs: Any) -> Any:
        compiling = torch.compiler.is_compiling()
        transformed = not compiling and private.transforms_active()
        if transformed or (not compiling and has_tangents(inputs)):
            if graph:
                return graph[1].apply(*inputs, *defaults[len(inputs) :])
            # results such as indices have no derivative
            inputs = tuple(value.detach() if isinstance(value, Tensor) else value for value in inputs)
        if transformed or not is_eager(inputs):
            if not compiling:
                check_devices(inputs)
            return registered(*inputs)
        inputs += defaults[len(inputs) :]
        if not torch.is_grad_enabled():
            return plain(*inputs)
        if not [each for each in inputs if isinstance(each, Tensor) and each.requires_grad]:
            return plain(*inputs)
        if graph:
            return graph[0].apply(*inputs)
        with torch.no_grad():
            return plain(*inputs)

    torch.library.register_vmap(name, functools.partial(_vmap, registered, directions))
    call.operator = registered  # type: ignore[attr-defined]
    call.graph = graph  # type: ignore[attr-defined]
    return cast("Callable[P, R]", call)


def fake(call: Any) -> Callable[[Callable[..., R]], Callable[..., R]]:
    """Register the function that infers the shapes of an `operator`'s results for torch.compile.

    The function's parameters are a subset of the operator's.
    """

    def register(shapes: Callable[..., R]) -> Callable[..., R]:
        needed = inspect.signature(shapes).parameters
        call.shapes = lambda given: shapes(**{name: given.arguments[name] for name in needed})
        _register_fake(call, call.shapes)
        return shapes

    return register


def _register_fake(call: Any, shapes: Callable[[inspect.BoundArguments], Any]) -> None:
    signature = inspect.signature(call)

    def of_inputs(*inputs: Any, **named: Any) -> Any:
        given = signature.bind(*inputs, **named)
        given.apply_defaults()
        return shapes(given)

    torch.library.register_fake(f"neural_renderer::{call.__name__}", of_inputs)


def gradient_of(
    forward: Any, *names: str, once: bool = False, leave_out: str = ""
) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Register the operator that computes the gradients of another one to its inputs of these names.

    Its last parameter, ``*inputs``, stands for the inputs of that operator, except ``leave_out``. Results are empty
    (`gradient_shape`) where the parameter ``{name}_too`` is False. Without names it needs its own `fake`. With
    ``once``, its own gradient is an error.
    """

    def register(function: Callable[P, R]) -> Callable[P, R]:
        call = (differentiable_once if once else operator)(_with_inputs_of(forward, leave_out, function))
        if names:
            _fake_gradients(call, names)
        return call

    return register


def _with_inputs_of(forward: Any, leave_out: str, function: Callable[P, R]) -> Callable[P, R]:
    """Declare the last parameter of a function, ``*inputs``, as the parameters of an operator."""
    signature, inputs = inspect.signature(function), inspect.signature(forward).parameters
    parameters = [*signature.parameters.values()][:-1] + [each for name, each in inputs.items() if name != leave_out]
    defaults = [each.default for each in parameters]  # torch's dispatcher leaves out those at the end
    plain: Callable[..., Any] = function

    @functools.wraps(function)
    def complete(*given: Any) -> Any:
        return plain(*given, *defaults[len(given) :])

    complete.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    return cast("Callable[P, R]", complete)


def gradient_shape(value: Tensor | None, wanted: bool = True) -> tuple[int, ...]:
    """Return the shape of the gradient to an argument; empty if it is not needed or the argument is None."""
    return (0,) if value is None else tuple(value.shape) if wanted else (0,) * value.dim()


def _fake_gradients(call: Any, names: tuple[str, ...]) -> None:
    def shapes(given: inspect.BoundArguments) -> Any:
        like, values = next(each for each in given.args if each is not None), given.arguments  # an incoming gradient
        found = (like.new_empty(gradient_shape(values.get(name), values.get(f"{name}_too", True))) for name in names)
        return tuple(found) if len(names) > 1 else next(found)

    _register_fake(call, shapes)


def differentiable(
    call: Any,
    backward: Callable[..., Any],
    setup_context: Callable[..., Any] | None = None,
    forward_mode: Callable[..., Any] | None = None,
    directions: int = 0,
) -> None:
    """Give an `operator` its derivatives.

    Args:
        call: The operator.
        backward, setup_context: As for `torch.library.register_autograd`. The backward pass may return a dictionary of
            gradients by input name; those that are not needed are dropped.
        forward_mode: Function of the operator's inputs and of their tangents, None where an input has none. Returns the
            tangents of the results. None: forward mode is an error (RuntimeError).
        directions: Number of leading arguments with a dimension [T, ...], to which `torch.func.vmap` may add.
    """
    name, parameters = call.__name__, tuple(inspect.signature(call).parameters)

    def in_order(ctx: Any, *grads: Any) -> Any:
        found = backward(ctx, *grads)
        if not isinstance(found, dict):
            return found
        needed = zip(parameters, ctx.needs_input_grad, strict=False)  # torch's dispatcher leaves out defaults
        return tuple(found.get(each) if needs else None for each, needs in needed)

    torch.library.register_autograd(f"neural_renderer::{name}", in_order, setup_context=setup_context)

    def forward(ctx: Any, *inputs: Any) -> Any:
        output = call.__wrapped__(*inputs)
        if setup_context is not None:
            setup_context(ctx, inputs, output)
        return output

    def untransformed(*inputs: Any) -> Any:
        return call.__wrapped__(*inputs) if is_eager(inputs) else call.operator(*inputs)

    def keep(ctx: Any, inputs: tuple[Any, ...], output: Any) -> None:
        if setup_context is not None:
            setup_context(ctx, inputs, output)
        tensors, ctx.inputs = _divided(inputs)
        ctx.save_for_forward(*tensors)
        ctx.set_materialize_grads(False)  # an input without a tangent has None
        ctx.outputs = [(each.shape, each.dtype, each.device) for each in _several(output)]

    def vjp(ctx: Any, *grads: Tensor | None) -> Any:
        like = zip(grads, ctx.outputs, strict=True)
        return in_order(
            _Alive(ctx),
            *(
                torch.zeros(shape, dtype=dtype, device=at) if grad is None else grad
                for grad, (shape, dtype, at) in like
            ),
        )

    def jvp(ctx: Any, *tangents: Tensor | None) -> Any:
        if forward_mode is None:
            _refuse_forward_mode(name)
        return forward_mode(_merged(ctx.saved_tensors, ctx.inputs), tangents)

    methods = {"forward": staticmethod(forward), "backward": staticmethod(in_order)}
    # Forward mode, and the rules of `torch.func`, need a forward pass without a context.
    separate = {
        "forward": staticmethod(untransformed),
        "setup_context": staticmethod(keep),
        "backward": staticmethod(vjp),
        "jvp": staticmethod(jvp),
        "vmap": staticmethod(functools.partial(_vmap, call, directions)),
    }
    call.graph[:] = [type(name, (torch.autograd.Function,), part) for part in (methods, separate)]


def save_inputs(ctx: Any, inputs: Sequence[Any], output: Any) -> None:
    """Save all inputs of an operator for its gradient, which reads them by `saved_inputs`."""
    tensors, ctx.others = _divided(inputs)
    ctx.save_for_backward(*tensors)


def saved_inputs(ctx: Any) -> list[Any]:
    """Return the inputs that `save_inputs` saved."""
    return _merged(ctx.saved_tensors, ctx.others)


def _divided(inputs: Sequence[Any]) -> tuple[list[Tensor | None], list[Any]]:
    """Separate inputs into tensors and others, each list with None in the places of the other."""
    tensors = [value if isinstance(value, Tensor) else None for value in inputs]
    return tensors, [value if tensor is None else None for tensor, value in zip(tensors, inputs, strict=True)]


def _merged(tensors: Sequence[Tensor | None], others: Sequence[Any]) -> list[Any]:
    return [other if tensor is None else tensor for tensor, other in zip(tensors, others, strict=True)]


class _Alive:
    """Context of a backward pass that may run after its `torch.func` transformation has ended.

    After `vjp` returns, saved tensors are wrappers without storage. torch unwraps them; our kernels must do so here.
    """

    def __init__(self, ctx: Any) -> None:
        self._ctx = ctx

    def __getattr__(self, name: str) -> Any:
        return getattr(self._ctx, name)

    @property
    def saved_tensors(self) -> tuple[Tensor | None, ...]:
        return tuple(None if each is None else private.unwrap_dead(each) for each in self._ctx.saved_tensors)


def forward_operator(
    directions: int, of: Any = None, leave_out: str = ""
) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Register the operator that computes tangents in T directions together; it has no derivatives itself.

    Its first ``directions`` arguments are tangents of inputs, [T, ...] or None, and its results are tangents, too. Its
    last parameter, ``*inputs``, stands for the inputs of the operator ``of``, as in `gradient_of`; its results then
    have that operator's shapes, with T in front. Without ``of`` it needs its own `fake`.
    """

    def register(function: Callable[P, R]) -> Callable[P, R]:
        function = function if of is None else _with_inputs_of(of, leave_out, function)
        forward = _registered(function, directions)
        if of is not None:
            _fake_changes(forward, of.shapes, directions)
        refuse = functools.partial(refuse_second, function.__name__)
        differentiable(forward, lambda ctx, *grads: refuse(), None, lambda inputs, tangents: refuse(), directions)
        return forward

    return register


def _fake_changes(call: Any, of: Callable[[inspect.BoundArguments], Any], directions: int) -> None:
    def shapes(given: inspect.BoundArguments) -> Any:
        count = next(len(each) for each in given.args[:directions] if each is not None)
        found = tuple(each.new_empty((count, *each.shape)) for each in _several(of(given)))
        return found if len(found) > 1 else found[0]

    _register_fake(call, shapes)


def in_direction(forward: Callable[..., Any], tangents: Sequence[Tensor | None], *others: Any) -> Any:
    """Call a `forward_operator` for a single direction: tangents and results without their dimension T."""
    results = forward(*(None if each is None else each[None] for each in tangents), *others)
    return results[0] if isinstance(results, Tensor) else tuple(each[0] for each in results)


def sum_of(parts: Sequence[Tensor]) -> Tensor | None:
    """Sum the tangents of a result that come from several inputs; None without any."""
    return functools.reduce(torch.add, parts) if parts else None


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


def _vmap_in_a_loop(call: Any, info: Any, in_dims: tuple[int | None, ...], *inputs: Any) -> Any:
    """Run an operator for each element of the dimension of `torch.func.vmap`, and stack the results."""
    results = []
    for n in range(info.batch_size):
        element = (
            value.select(d, n) if isinstance(d, int) else value for value, d in zip(inputs, in_dims, strict=True)
        )
        results.append(_several(call(*element)))
    stacked = tuple(torch.stack(parts) for parts in zip(*results, strict=True))
    return (stacked[0], 0) if len(stacked) == 1 else (stacked, (0,) * len(stacked))


def _vmap(call: Any, directions: int, info: Any, in_dims: tuple[int | None, ...], *inputs: Any) -> Any:
    """Run a `forward_operator` once for all directions, those of `torch.func.vmap` included; others in a loop."""
    if not directions or any(isinstance(dim, int) for dim in in_dims[directions:]):
        return _vmap_in_a_loop(call, info, in_dims, *inputs)
    count = info.batch_size

    def joined(value: Tensor | None, dim: int | None) -> Tensor | None:
        if value is None:
            return None
        return (value.expand(count, *value.shape) if dim is None else value.movedim(dim, 0)).flatten(0, 1)

    tangents = [joined(value, dim) for value, dim in zip(inputs[:directions], in_dims, strict=False)]
    results = tuple(each.unflatten(0, (count, -1)) for each in _several(call(*tangents, *inputs[directions:])))
    return (results[0], 0) if len(results) == 1 else (results, (0,) * len(results))


def _several(output: Tensor | tuple[Tensor, ...]) -> tuple[Tensor, ...]:
    return (output,) if isinstance(output, Tensor) else output


def is_plain(inputs: tuple[Any, ...]) -> bool:
    """Test whether all tensors are plain: kernels can read them, without tangents, neither traced nor transformed.

    A lazily negated view is not plain, because its storage holds other values.
    """
    return not private.transforms_active() and is_eager(inputs) and not has_tangents(inputs)


def is_eager(inputs: tuple[Any, ...]) -> bool:
    """Test whether kernels can read all tensors, and none is traced; a transformation of `torch.func` may be active."""
    if torch.compiler.is_compiling() or (private.dispatch_modes() and not recorder()):
        return False
    for value in inputs:  # a loop, because `any` takes twice as long, which matters for small scenes
        if isinstance(value, Tensor) and (type(value) not in _PLAIN or not runs_kernels(value) or value.is_neg()):
            return False
    return True


def may_read_values() -> bool:
    """Test whether a step may depend on values: not if it is recorded."""
    return recorder() is None


def needs_gradient(*tensors: Tensor) -> bool:
    """Test whether a derivative with respect to one of the tensors may be needed, in either mode.

    Inside a transformation of `torch.func` this is unknown, so the answer is True.
    """
    if has_tangents(tensors):
        return True
    if not torch.is_grad_enabled():
        return False
    return private.transforms_active() or any(tensor.requires_grad for tensor in tensors)


def of_constants(function: Callable[..., R], *tensors: Tensor) -> R | None:
    """Call a function on constant tensors, without their wrappers of `torch.func`; None if one may have derivatives.

    Values cached for a constant can then be reused in forward mode.
    """
    if torch.compiler.is_compiling():
        return None
    if is_plain(tensors) and not needs_gradient(*tensors):
        return function(*tensors)
    constants = [_unwrapped(tensor) for tensor in tensors]
    if any(each is None for each in constants):
        return None
    with private.without_transforms():
        return function(*constants)


def _unwrapped(tensor: Tensor) -> Tensor | None:
    while not (has_tangents((tensor,)) or (tensor.requires_grad and torch.is_grad_enabled())):
        inner = private.unwrapped(tensor)
        if inner is None or inner is tensor:
            return inner if inner is not None and is_eager((inner,)) else None
        tensor = inner
    return None


def has_tangents(values: Iterable[Any]) -> bool:
    """Test whether a tensor among the values has a tangent, for forward mode."""
    if not private.may_have_tangents():
        return False
    # In inference mode only `torch.func.jvp` records derivatives.
    if not private.records_derivatives() and not private.transforms_active():
        return False
    return any(isinstance(each, Tensor) and forward_ad.unpack_dual(each).tangent is not None for each in values)


def _refuse_forward_mode(name: str) -> NoReturn:
    raise RuntimeError(
        f"{name}: expected tensors without tangents, got one to differentiate in forward mode; this operator "
        "has gradients in reverse mode only (backward)"
    )
