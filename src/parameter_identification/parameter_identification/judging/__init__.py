"""Trajectory error of recorded drives."""
