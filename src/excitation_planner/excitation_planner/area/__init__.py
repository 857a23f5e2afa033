"""The ground that a vehicle may use, and whether a maneuver fits on it."""
