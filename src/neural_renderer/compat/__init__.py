"""Interface of the first `neural_renderer` packages. New code does not need it."""
