"""Rigs in the commands `render` and `pose`."""
