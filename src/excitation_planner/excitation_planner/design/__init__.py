"""Search of the operation parameters for the most informative maneuver."""
