"""Photographs without cameras, for `neural-renderer fit`."""
