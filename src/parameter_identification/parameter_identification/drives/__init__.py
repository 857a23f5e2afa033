"""Drives as they were recorded: bags to signals."""
