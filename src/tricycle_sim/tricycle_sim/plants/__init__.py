"""Plants: the vehicle that the boards drive, our own model or another simulator's."""

OWN = "own"
"""The name of our own vehicle's model; it is no entry point."""
