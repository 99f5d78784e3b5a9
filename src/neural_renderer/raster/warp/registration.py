"""Registering a Python function as a torch operator."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from torch.autograd.forward_ad import unpack_dual


def operator(function: Callable[..., Any]) -> Any:
    """Make the annotated function the operator ``neural_renderer::<its name>``, opaque to torch.compile.

    `torch.library.custom_op` does the same, but its first call imports torch's compiler, over a second in each process.
    Derivatives in forward mode, which torch would take for zero, are an error (RuntimeError).
    """
    name = f"neural_renderer::{function.__name__}"
    torch.library.define(name, torch.library.infer_schema(function, mutates_args=()))
    torch.library.impl(name, "default", function)
    registered = getattr(torch.ops.neural_renderer, function.__name__).default

    @functools.wraps(function)
    def call(*inputs: Any) -> Any:
        if not torch.compiler.is_compiling():
            for value in inputs:
                if isinstance(value, Tensor) and unpack_dual(value).tangent is not None:
                    raise RuntimeError(
                        f"{function.__name__}: expected tensors without tangents, got one to differentiate in forward "
                        "mode; the rasteriser has gradients in reverse mode only (backward)"
                    )
        return registered(*inputs)

    call.operator = registered  # type: ignore[attr-defined]
    return call


def differentiable_once(function: Callable[..., Any]) -> Any:
    """The same for the operator that computes a gradient: whoever asks for the gradient's gradient gets an error."""
    backward = operator(function)

    def refuse(ctx: Any, *grads: Any) -> Any:
        raise RuntimeError(
            f"{function.__name__}: the rasteriser has first derivatives only, got a second one to compute"
        )

    torch.library.register_autograd(f"neural_renderer::{function.__name__}", refuse)
    return backward
