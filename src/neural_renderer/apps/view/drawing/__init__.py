"""Drawing for the viewer: copies of meshes, arrays for a graphics card, and our own renderer from the same view."""
