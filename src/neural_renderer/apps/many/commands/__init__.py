"""Commands for many models or runs: `dataset` and `batch`."""
