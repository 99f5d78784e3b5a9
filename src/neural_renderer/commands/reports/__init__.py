"""Results of the commands: files, sheets of pictures and numbers."""
