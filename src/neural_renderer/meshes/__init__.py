"""Meshes: with texture cubes, with images, in batches; what is computed from vertices and faces alone."""
