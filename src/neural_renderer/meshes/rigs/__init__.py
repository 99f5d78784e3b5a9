"""Rigs: meshes deformed by joints and morph targets."""

from .rig import Pose, Rig

__all__ = ["Pose", "Rig"]
