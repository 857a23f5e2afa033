"""What the boards drive: our own vehicle, or one of somebody else."""

OWN = "own"
"""The name of our own vehicle's model; it is no entry point."""
