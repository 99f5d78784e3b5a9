"""Reconstruction networks, their configurations and checkpoints."""
