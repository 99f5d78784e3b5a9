"""Image formats that Pillow does not write, or not as needed here: GIF, Radiance, OpenEXR, and PNG in strips."""
