"""Meshes with texture cubes or images, batches, primitives, rigs, subdivision, normals and topology."""
