"""Lights: ambient and directional, and spherical harmonics."""
