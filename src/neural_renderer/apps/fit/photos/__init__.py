"""Photographs alone: their cameras by structure from motion, and the masks of the object in them."""

from .copies import Photographs, copy_photographs
from .known_masks import write_known_masks
from .motion import Motion, find_cameras
from .object_masks import find_masks

__all__ = ["Motion", "Photographs", "copy_photographs", "find_cameras", "find_masks", "write_known_masks"]
