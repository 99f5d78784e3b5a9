"""Remeshing: local operations on triangle meshes, each on many edges at once."""
