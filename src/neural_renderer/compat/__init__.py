"""Compatibility: names of the first `neural_renderer` packages and of nvdiffrast, and modules under old names."""
