"""Remeshing: local operations on triangle meshes, vectorised over edges."""
