"""Data sets for reconstruction: rendered views and voxels of 3D models."""
