"""Pictures of results: photographs of meshes, turntables, sheets and curves."""
