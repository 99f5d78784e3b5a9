"""Meshes that joints bend and morph targets shape."""

from .rig import Pose, Rig

__all__ = ["Pose", "Rig"]
