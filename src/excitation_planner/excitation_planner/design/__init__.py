"""Design: the operation parameters of the maneuver that teaches most, for any simulator."""
