"""PLY files: text, and binary numbers of both byte orders."""

from .reader import read_ply

__all__ = ["read_ply"]
