"""Least-squares estimation of parameters from recorded drives."""
