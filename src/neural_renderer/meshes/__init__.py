"""Meshes with texture cubes or images, batches of meshes, primitives, normals and topology."""
