"""What applications share: options, checks, progress, the command line, masks, pictures, feature networks."""
