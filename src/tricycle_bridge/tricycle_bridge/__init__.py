"""DRIVE: PLC protocol, serial links and the ROS 2 bridge."""

__version__ = "0.1.0"  # of all six packages
