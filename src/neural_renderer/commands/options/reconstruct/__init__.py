"""Options of the subcommands of `neural-renderer reconstruct`."""
