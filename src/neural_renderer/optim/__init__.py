"""Solvers of least-squares problems whose residuals are images.

`GaussNewton` needs few steps, because it uses the Jacobian of the pixels. `pyramid` makes residuals whose derivatives
hold for motions of several pixels.
"""

from .gauss_newton import GaussNewton
from .pyramid import pyramid

__all__ = ["GaussNewton", "pyramid"]
