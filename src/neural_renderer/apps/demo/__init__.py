"""Command `demo`: a turntable, and a sphere that becomes a duck. Built on `fit` and `reconstruct`."""
