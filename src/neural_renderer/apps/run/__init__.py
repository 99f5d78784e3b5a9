"""Command `run`: programs that need nvdiffrast or CUDA, without them."""
