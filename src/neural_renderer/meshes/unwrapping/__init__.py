"""Unwrapping of a surface onto one image: charts, and the colours of their texels."""
