"""What all packages share."""

__version__ = "0.1.0"  # of all packages
