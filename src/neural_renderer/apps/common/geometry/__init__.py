"""Meshes that are changed: remeshing by local operations, vectorised over edges; closest points; texture charts."""
