"""Camera files: of NeRF, COLMAP, IDR, NeuS, BOP and Middlebury, and cameras.json and .csv written by hand."""

from .posed import CameraFile, PosedImage
from .read import find_camera_file, read_camera_file

__all__ = ["CameraFile", "PosedImage", "find_camera_file", "read_camera_file"]
