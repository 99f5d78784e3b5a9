"""Meshes with texture cubes or images, batches of meshes, primitives, demonstration models, normals and topology."""
