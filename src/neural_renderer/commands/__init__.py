"""Subcommands of `neural-renderer`, one module each with a function `run`, imported when called (see `cli`)."""
