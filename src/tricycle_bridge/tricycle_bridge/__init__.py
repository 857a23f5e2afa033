"""DRIVE: PLC protocol, serial links and the ROS 2 bridge."""
