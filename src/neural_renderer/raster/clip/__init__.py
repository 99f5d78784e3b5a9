"""Operators on vertices in clip space and on images with row 0 at the bottom, as OpenGL has them."""
