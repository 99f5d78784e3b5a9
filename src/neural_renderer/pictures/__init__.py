"""Pictures of results: photographs of meshes, sheets and curves."""
