"""Measurements of the boards: joined into joint readings, and compared with other sensors."""
