"""The subcommands of `neural-renderer`, one module each, imported only when they are called for (see `cli`)."""
