"""Back to where a maneuver starts: arcs that a vehicle can drive, a route of them, its pursuit."""
