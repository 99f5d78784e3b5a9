"""Meshes with texture cubes or images, batches, primitives, demonstration models, normals and topology."""
