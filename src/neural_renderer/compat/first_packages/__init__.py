"""Names and classes of the first `neural_renderer` packages."""
