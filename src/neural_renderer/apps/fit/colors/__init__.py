"""Colours of a known shape: exposure of the photos, views that show something else, and the texture."""
