"""Networks of reconstruction, their configurations and checkpoints."""
