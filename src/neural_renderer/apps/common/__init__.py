"""Shared parts of the applications: options, checks, progress, masks, pictures, feature networks."""
