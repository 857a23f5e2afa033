"""Bring-up of two boards on a vehicle, step by step, and its record."""
