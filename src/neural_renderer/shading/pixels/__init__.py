"""Per-pixel shading: the visible surface, its materials and normal maps, shading models."""
