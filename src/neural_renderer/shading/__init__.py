"""Lights, reflection models, environments, and per-pixel shading."""
