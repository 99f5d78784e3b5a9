"""Light in each pixel: the visible surface, its materials and normal maps, shading models."""
