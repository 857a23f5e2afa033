"""The `tricycle` command."""
