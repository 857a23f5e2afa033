"""Default supply voltages of the boards, outside of which they do not arm.

Low and high in V; 0 is not checked.
"""

DRIVE_SUPPLY_THRESHOLDS = (40.0, 0.0)
"""Thresholds of the battery: 13 cells in series at 3.1 V; the input's range is the upper end."""

STEER_SUPPLY_THRESHOLDS = (10.0, 14.0)
"""Thresholds of the servo's 12 V regulator."""

SUPPLY_LIMIT = 54.9
"""Largest threshold of a supply [V]: the boards measure up to 55 V."""
