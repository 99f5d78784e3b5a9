"""Solvers of least-squares problems whose residuals are images.

`GaussNewton` needs few steps, because it knows how each pixel changes with each parameter. `pyramid` makes residuals
that reach farther than a pixel.
"""

from .gauss_newton import GaussNewton
from .pyramid import pyramid

__all__ = ["GaussNewton", "pyramid"]
