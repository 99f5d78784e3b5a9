"""Replay of recorded steps: for a small scene Python and torch take ten times as long as the kernels.

The second call of a step with the same constants and shapes is recorded, forward and backward. Later ones launch its
kernels again in one `torch.autograd.Function`: the addresses of its tensors are written into the arguments of
the kernels, which are kept.
"""

from __future__ import annotations

import ctypes
import itertools
import os
import threading
from collections.abc import Callable, Hashable, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...base import private
from ...base.recording import Launch, Memory, Operation, Recorder, Unrepeatable, View
from . import launch, layout
from .memory import empty, zeros
from .registration import is_plain

Function = Callable[..., tuple[Tensor, ...]]
Key = Callable[[], Hashable]

_IS_ON = os.environ.get("NEURAL_RENDERER_REPLAY") != "0"
_MOST = 64  # steps that are remembered
_LARGE = 1 << 15  # numbers that torch computes on one thread, at most

# The last used is last. None: seen once. False: not to be recorded. Changes are atomic, but one may undo another.
_plans: dict[Hashable, Plan | bool | None] = {}

if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_plans.clear)  # another thread of the parent may hold a lock


def replay(make: Callable[[], Function], inputs: tuple[Tensor, ...], describe: Key) -> tuple[Tensor, ...] | None:
    """Return ``make()(*inputs)`` by a recording; None without one, or if a check of values fails.

    Args:
        make: Returns the function. Its results depend on ``inputs`` and on constants that nobody changes. It does not
            hold the inputs. Called only to record it.
        inputs: Plain tensors of one device (`is_plain`).
        describe: Returns a key of the function and its constants, so that equal keys with inputs of equal shapes are
            equal steps, or raises Unrepeatable. Called only where the inputs may be recorded.
    """
    device, moving = inputs[0].device, torch.is_grad_enabled()
    stream = launch.stream_of(device)
    untested = device.type == "cuda" and launch.emulator is None  # no GPU has run it
    if not _IS_ON or untested or stream is None or not private.may_record():
        return None
    for each in inputs:
        if each.dtype != torch.float32 or not each.is_contiguous() or (each.is_cpu and each.numel() > _LARGE):
            return None
    shapes = tuple([(each.shape, moving and each.requires_grad) for each in inputs])
    modes = (torch.get_default_dtype(), torch.is_inference_mode_enabled(), torch.are_deterministic_algorithms_enabled())
    try:
        key = (describe(), shapes, device, stream, modes, torch.get_num_threads(), launch.emulator, layout.as_on_cuda)
    except Unrepeatable:
        return None
    is_new = key not in _plans
    plan = _plans[key] = _plans.pop(key, None)
    if len(_plans) > _MOST:
        _plans.pop(tuple(_plans)[0], None)  # noqa: RUF015 (atomic)
    if is_new or plan is False:
        return None
    try:
        if not isinstance(plan, Plan):
            plan = _plans[key] = Plan(make(), inputs)
        return plan.apply(inputs)
    except Unrepeatable:
        _plans[key] = False
    except ValueError:  # the caller's own check names the argument
        pass
    return None


class Plan:
    """A recorded step.

    Attributes:
        function: The step.
        constant: Numbers of the results without a gradient.
    """

    def __init__(self, function: Function, inputs: Sequence[Tensor]) -> None:
        self.function, self._device, self._lock = function, inputs[0].device, threading.Lock()
        recorder = Recorder()
        with torch.no_grad():
            function(*inputs)  # makes what is kept with the constants, which need not be made by each replay
        leaves = [each.detach().clone() for each in inputs]  # not two inputs with one address
        for leaf, given in zip(leaves, inputs, strict=True):
            recorder.hold(leaf, "given")
            leaf.requires_grad_(given.requires_grad and torch.is_grad_enabled())
        with recorder:
            outputs = function(*leaves)
        results = [_result(recorder, each) for each in outputs]
        self.constant = [k for k, each in enumerate(outputs) if not each.requires_grad]
        self._moves, count = len(self.constant) < len(outputs), len(recorder.steps)
        recorder.backward = True
        grads = [torch.zeros_like(each) for each in outputs]
        self._grads = [recorder.hold(grad, "given") for grad in grads]
        with recorder:
            found = gradients(outputs, leaves, grads) if self._moves else []
        self._results = results, [None if each is None else _result(recorder, each) for each in found]
        self._checks = recorder.checks
        self._prepare(recorder.memories)
        self._steps = self._joined(recorder.steps[:count]), self._joined(recorder.steps[count:])

    def _prepare(self, memories: Sequence[Memory]) -> None:
        """List what each pass makes, and what the forward pass saves for the backward pass."""
        views = {view.memory: view for views in self._results for view in views if view is not None}
        if any(memories[k].crosses or memories[k].kind == "given" for k in views):
            raise Unrepeatable("results share their memory")
        self._made: tuple[list[Any], list[Any]] = [], []
        for k, one in enumerate(memories):
            if one.kind == "computed" and one.tensor.is_cpu and one.tensor.numel() > _LARGE:
                raise Unrepeatable("torch computes with all its threads")
            if one.kind == "made":
                shape, dtype = views.get(k, one.tensor).shape, one.tensor.dtype
                self._made[one.backward].append((k, zeros if one.is_zero else empty, shape, dtype))
        self._saved = [k for k, one in enumerate(memories) if one.crosses and one.kind != "given"]
        self._count = len(memories)

    def _joined(self, steps: Sequence[Launch | Operation]) -> list[Operation | _Launches]:
        """Join launches that follow each other."""
        found: list[Any] = []
        for are_launches, group in itertools.groupby(steps, lambda step: isinstance(step, Launch)):
            several: Any = [*group]
            found += [_Launches(several)] if are_launches else several
        return found

    def apply(self, inputs: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
        """Compute the results. Raises ValueError if a check of values fails."""
        return _Replay.apply(self, *inputs) if self._moves else self.forward(inputs)[0]  # type: ignore[no-untyped-call]

    def forward(self, inputs: Sequence[Tensor]) -> tuple[tuple[Tensor, ...], list[Tensor]]:
        """Compute the results, and the tensors that `backward` needs beside the inputs."""
        memory = self._run(dict(enumerate(inputs)), False)
        for check in self._checks:
            self._compute(check, memory)
        return tuple([self._view(each, memory).data for each in self._results[0]]), [memory[k] for k in self._saved]

    def backward(self, inputs: Sequence[Tensor], saved: Sequence[Tensor], grads: Sequence[Tensor]) -> list[Any]:
        """Compute the gradients to the inputs."""
        memory = dict(enumerate(inputs)) | dict(zip(self._saved, saved, strict=True))
        memory |= {k: grad.contiguous() for k, grad in zip(self._grads, grads, strict=True)}
        memory = self._run(memory, True)
        return [None if each is None else self._view(each, memory) for each in self._results[1]]

    def _run(self, memory: dict[int, Tensor], backward: bool) -> dict[int, Tensor]:
        """Run a pass, and add the tensors that it makes to those of the memory."""
        for k, make, shape, dtype in self._made[backward]:
            memory[k] = make(shape, self._device, dtype)
        addresses = np.zeros(self._count, np.int64)
        addresses[[*memory]] = [each.data_ptr() for each in memory.values()]
        with self._lock:
            for step in self._steps[backward]:
                if isinstance(step, _Launches):
                    step.run(addresses)
                    continue
                result = self._compute(step, memory)
                if step.result >= 0:
                    memory[step.result], addresses[step.result] = result, result.data_ptr()
        return memory

    def _compute(self, step: Operation, memory: dict[int, Tensor]) -> Any:
        return step.function(*[self._tensors(each, memory) for each in step.arguments], **step.named)

    def _tensors(self, value: Any, memory: dict[int, Tensor]) -> Any:
        if type(value) is View:
            return self._view(value, memory)
        return [self._tensors(each, memory) for each in value] if type(value) is tuple else value

    def _view(self, view: View, memory: dict[int, Tensor]) -> Tensor:
        tensor = memory[view.memory]
        if tensor.shape == view.shape and tensor.stride() == view.stride and tensor.dtype == view.dtype:  # all of it
            return tensor
        if tensor.dtype != view.dtype:
            tensor = tensor.view(-1).view(view.dtype)
        return tensor.as_strided(view.shape, view.stride, tensor.storage_offset() + view.offset // tensor.itemsize)


class _Launches:
    """Launches that follow each other, with their arguments in one block of memory."""

    def __init__(self, launches: Sequence[Launch]) -> None:
        ends = np.cumsum([1 + -(-ctypes.sizeof(each.arguments[2]) // 8) for each in launches])
        self._words = np.zeros(ends[-1], np.int64)  # a 0 before the arguments of each, as `prepared` needs
        self._constants = [each.constants for each in launches]
        self._launches, fields = [], []
        for one, first in zip(launches, [1, *(ends[:-1] + 1)], strict=True):
            kernel, tasks, call, device, least = one.arguments
            here = type(call).from_buffer(self._words, 8 * first)
            ctypes.pointer(here)[0] = call
            self._launches.append(launch.prepared(kernel, tasks, here, device, least))
            fields += [(first + field // 8, memory, offset) for field, memory, offset in one.pointers]
        self._pointers = np.array(fields, np.int64).reshape(-1, 3).T.copy()

    def run(self, addresses: Any) -> None:
        """Launch the kernels on tensors with these addresses."""
        words, numbers, offsets = self._pointers
        self._words[words] = addresses[numbers] + offsets
        for run in self._launches:
            run()


class _Replay(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, plan: Plan, *inputs: Tensor) -> Any:
        results, saved = plan.forward(inputs)
        ctx.plan = plan
        ctx.save_for_backward(*inputs, *saved)
        ctx.mark_non_differentiable(*[results[k] for k in plan.constant])
        return results

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> Any:
        count, again = len(ctx.needs_input_grad) - 1, torch.is_grad_enabled()  # again: by a second derivative
        inputs, saved = ctx.saved_tensors[:count], ctx.saved_tensors[count:]
        if not again and is_plain(grads):
            return None, *ctx.plan.backward(inputs, saved, grads)
        with torch.enable_grad():
            outputs = ctx.plan.function(*inputs)
        return None, *gradients(outputs, inputs, grads, again)


def _result(recorder: Recorder, tensor: Tensor) -> View:
    view = recorder.find(tensor)
    if view is None or not tensor.is_contiguous() or tensor.nbytes != recorder.memories[view.memory].size:
        raise Unrepeatable("a result is a constant, or a part of a tensor")
    return view


def gradients(outputs: Any, inputs: Any, grads: Any, again: bool = False) -> list[Tensor | None]:
    """Compute the gradient to each input; None where there is none. With ``again`` they are differentiable."""
    moving, given = zip(*[pair for pair in zip(outputs, grads, strict=True) if pair[0].requires_grad], strict=True)
    wanted = [each for each in inputs if each.requires_grad]
    found = iter(torch.autograd.grad(moving, wanted, given, create_graph=again, allow_unused=True))
    return [next(found) if each.requires_grad else None for each in inputs]
