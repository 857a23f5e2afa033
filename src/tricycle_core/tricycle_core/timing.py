"""The control period; without NumPy, so that the by-wire protocol needs none."""

TICK = 0.01
"""Control period of both PLCs, and of every trajectory and command table on it [s]."""
