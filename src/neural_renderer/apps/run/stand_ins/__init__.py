"""Modules that generators of meshes import and that need CUDA, on this package's parts. `finder` lists them."""
