"""Geometry that photographs show: depth by plane sweeping, the solid of the object, open surfaces."""
