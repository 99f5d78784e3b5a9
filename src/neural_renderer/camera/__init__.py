"""Cameras: world vertices to screen coordinates (x right, y up, both in [-1, 1] over the image; z is the depth)."""

from __future__ import annotations

from .camera import Camera
from .lens import orthographic, perspective, projection
from .view import get_points_from_angles, look, look_at

__all__ = ["Camera", "get_points_from_angles", "look", "look_at", "orthographic", "perspective", "projection"]
