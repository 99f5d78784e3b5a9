"""Command `run`: programs that need nvdiffrast, PyTorch3D, modules of mesh generators or CUDA, without them."""
