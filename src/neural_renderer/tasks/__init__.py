"""What people do with a renderer, as library functions."""
