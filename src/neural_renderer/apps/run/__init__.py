"""Command `run`: programs that need nvdiffrast, modules of mesh generators or CUDA, without them."""
