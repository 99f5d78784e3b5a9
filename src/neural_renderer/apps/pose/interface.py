"""Poses: where a known object is, and how it is turned."""

from .find import ObjectPose, find_pose

__all__ = ["ObjectPose", "find_pose"]
