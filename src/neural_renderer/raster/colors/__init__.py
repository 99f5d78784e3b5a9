"""Operators that colour pixels, one per file: torch operator, gradient and Warp kernels."""
