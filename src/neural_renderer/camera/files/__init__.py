"""Camera files: transforms.json, cameras.json and .csv, COLMAP's models, Middlebury's ``*_par.txt``."""

from .posed import CameraFile, PosedImage
from .read import find_camera_file, read_camera_file

__all__ = ["CameraFile", "PosedImage", "find_camera_file", "read_camera_file"]
