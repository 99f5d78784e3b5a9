"""Materials and pictures of glTF files."""
