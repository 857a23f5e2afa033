"""DRIVE: PLC protocol, serial links and the bridge between ROS 2 and the two by-wire PLCs."""
