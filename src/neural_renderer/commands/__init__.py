"""Subcommands of `neural-renderer`. Each module has a function `run`; `cli` imports it when the command is called."""
