"""Command `info`: versions, devices, and a check that drawing works."""
