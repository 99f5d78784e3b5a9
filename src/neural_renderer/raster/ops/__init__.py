"""The operators of the rasteriser, one a file: torch operator, gradient and Warp kernels."""
