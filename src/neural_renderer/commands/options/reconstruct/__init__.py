"""What can be typed after each command of `neural-renderer reconstruct`."""
