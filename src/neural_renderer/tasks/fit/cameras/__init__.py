"""Refinement of cameras: poses and focal length, while the shape is fitted or after it."""
