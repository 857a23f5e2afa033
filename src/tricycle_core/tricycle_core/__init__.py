"""Basics that all packages share."""

__version__ = "0.2.0"  # of all packages
