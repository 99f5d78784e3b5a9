"""The score-function estimate of a gradient (REINFORCE), for comparison with the estimators of images.

Source: Williams, "Simple statistical gradient-following algorithms", 1992, as used for rendering by Rezende et al.,
"Unsupervised learning of 3D structure from images", NeurIPS 2016.

The renderer is a black box. Parameters x are replaced by x + s e with normal noise e, and the mean of the
loss L(x + s e) is differentiated through the probability of the noise:

    d/dx mean(L) = mean((L(x + s e) - b) e) / s.

The baseline b of a sample, the mean loss of the other samples, reduces noise and leaves the estimate unbiased.
Antithetic samples, pairs e and -e, cancel the even part of the loss, which has no slope.

Its mean is the gradient of the loss blurred by the spread s, which has a long range if s is large. Its noise grows with
the square root of the number of parameters and falls with that of samples.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from ....base import validate


def reinforce(
    loss: Callable[[Tensor], Tensor],
    parameters: Tensor,
    *,
    samples: int = 16,
    spread: float = 0.01,
    antithetic: bool = True,
    generator: torch.Generator | None = None,
) -> Tensor:
    """Compute a loss whose backward pass is a score-function estimate (REINFORCE), without gradients of the renderer.

    For comparison: each estimate draws many images, and is still far noisier than ``gradient="edge"``. It is of use if
    ``loss`` cannot be differentiated at all.

    Args:
        loss: Function of moved parameters, [S, ...], that returns one loss for each of them, [S]. It is called once,
            without gradients.
        parameters: Tensor of any shape, floating, for example vertices [V, 3] or angles [3].
        samples: Number S of moved copies, at least 2; even if ``antithetic``.
        spread: Standard deviation of the noise, in the units of the parameters, > 0. The estimated gradient is that of
            the loss averaged over this noise.
        antithetic: Whether samples are pairs with opposite noise.
        generator: Source of the noise; None for torch's own.

    Returns:
        Mean loss of the samples, a number of the type of the losses, differentiable in ``parameters`` once.

    Raises:
        TypeError, ValueError: An argument is out of range, or the losses do not fit.

    Example:
        >>> vertices, faces = nr.icosphere(1)
        >>> camera = nr.Camera.look_at((0.0, 0.0, -2.7))
        >>> def loss(moved):  # [S, V, 3]
        ...     return nr.render((moved, faces), camera, 32, outputs=("alpha",)).alpha.mean((1, 2))
        >>> _ = vertices.requires_grad_()
        >>> nr.reinforce(loss, vertices, samples=8).backward()
        >>> vertices.grad.shape
        torch.Size([42, 3])
    """
    if not isinstance(parameters, Tensor):
        raise TypeError(f"parameters: expected a tensor, got {type(parameters).__name__}")
    validate.real("parameters", parameters)
    samples, spread = validate.whole("samples", samples, 2), validate.positive("spread", spread)
    if validate.flag("antithetic", antithetic) and samples % 2:
        raise ValueError(f"samples: expected an even number for pairs of opposite noise, got {samples}")
    with torch.no_grad():
        count = samples // 2 if antithetic else samples
        # The noise is drawn where the generator lives, so that a seed gives the same numbers on every device.
        device = parameters.device if generator is None else generator.device
        noise = torch.randn((count, *parameters.shape), dtype=parameters.dtype, device=device, generator=generator)
        noise = noise.to(parameters.device)
        noise = torch.cat((noise, -noise)) if antithetic else noise
        losses = loss(parameters + spread * noise)
        if not isinstance(losses, Tensor):
            raise TypeError(f"loss: expected a function that returns a tensor, got {type(losses).__name__}")
        if losses.shape != (samples,):
            raise ValueError(f"loss: expected losses of shape [{samples}], got {validate.shape_of(losses)}")
        slope = _slope(losses.to(parameters.dtype), noise, antithetic) / spread
        mean = losses.mean()
    return _WithSlope.apply(parameters, slope, mean)  # type: ignore[no-untyped-call]


def _slope(losses: Tensor, noise: Tensor, antithetic: bool) -> Tensor:
    """Estimate the gradient by unit noise, in the shape of the parameters."""
    if antithetic:  # the baseline, equal for both of a pair, cancels
        first, second = losses.chunk(2)
        weights, noise = (first - second) / 2, noise[: len(first)]
    else:  # minus the mean of the other losses
        weights = (losses - losses.mean()) * len(losses) / (len(losses) - 1)
    return torch.tensordot(weights, noise, 1) / len(weights)


class _WithSlope(torch.autograd.Function):
    """Return a number as it is, with a given gradient to the parameters."""

    @staticmethod
    def forward(ctx, parameters, slope, mean):  # type: ignore[no-untyped-def]
        ctx.save_for_backward(parameters, slope)
        return mean.clone()

    @staticmethod
    def backward(ctx, grad):  # type: ignore[no-untyped-def]
        parameters, slope = ctx.saved_tensors
        return _Once.apply((grad * slope).to(slope.dtype), parameters), None, None  # type: ignore[no-untyped-call]


class _Once(torch.autograd.Function):
    """Return a gradient as it is, and refuse to differentiate it; as a constant, it would have zeros silently."""

    @staticmethod
    def forward(ctx, slope, parameters):  # type: ignore[no-untyped-def]
        return slope.clone()

    @staticmethod
    def backward(ctx, grad):  # type: ignore[no-untyped-def]
        raise RuntimeError("reinforce: the estimate has first derivatives only, got a second one to compute")
