"""Operators from vertices to visible points, one per file: torch operator, gradient, Warp kernels."""
