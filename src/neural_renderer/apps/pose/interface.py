"""Poses: position and rotation of a known object."""

from .find import ObjectPose, find_pose

__all__ = ["ObjectPose", "find_pose"]
