"""Slow float64 references in plain torch, to which the tests hold the kernels."""
