"""Warp kernels on torch tensors: launching, registering operators, shared geometry."""
