"""The operators that colour pixels, one a file: torch operator, gradient and Warp kernels."""
