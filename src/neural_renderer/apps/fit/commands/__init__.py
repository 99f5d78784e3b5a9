"""Command `fit`."""
