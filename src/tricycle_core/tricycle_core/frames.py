"""Frames of positions and motions (REP-105)."""

BASE_LINK = "base_link"
"""Of the vehicle: at its centre of mass, x ahead, y to the left, z up (REP-103)."""

ODOM = "odom"
"""Of the ground: fixed, and positions in it do not jump."""

MANEUVER = "maneuver"
"""Of a maneuver's path and reference: its origin is the pose of the start."""
