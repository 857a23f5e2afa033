"""Sobol' indices of a simulator from Kriging models of its output."""
