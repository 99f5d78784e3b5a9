"""The interface of the first `neural_renderer` packages; new code does not need it."""
