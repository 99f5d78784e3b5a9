"""Photographs without cameras: structure from motion finds these, and the object is segmented."""

from .copies import Photographs, copy_photographs
from .masks.known_masks import write_known_masks
from .masks.object_masks import find_masks
from .motion import Motion, find_cameras

__all__ = ["Motion", "Photographs", "copy_photographs", "find_cameras", "find_masks", "write_known_masks"]
