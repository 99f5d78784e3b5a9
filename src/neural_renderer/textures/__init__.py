"""Texture images: sampling with mipmaps, and filling the gaps between their charts."""
