"""The surface without its colours: cleaning, fewer faces, moves of vertices."""
