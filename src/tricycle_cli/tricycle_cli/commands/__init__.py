"""The subcommands of `tricycle`, one module each."""
