"""The operators from vertices to the visible points of pixels, one a file: torch operator, gradient, Warp kernels."""
