"""DRIVE: PLC protocol, serial links and the ROS 2 bridge."""

from tricycle_core.renamed import install

install()
