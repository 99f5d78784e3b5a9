"""Command `compare`: how different two meshes look, and how far apart their surfaces are."""
