"""Texture images: sampling with mipmaps, and filling of the gutters between charts."""
