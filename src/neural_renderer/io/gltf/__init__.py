"""Materials of glTF and GLB files: what trimesh leaves out of them."""
