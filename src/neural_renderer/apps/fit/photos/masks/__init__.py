"""Masks of the object: found in colours, in a background that stands still, or in depth."""
