"""The by-wire link: PLC protocol, serial links to both PLCs and the ROS 2 bridge node."""

from tricycle_core.renamed import install

install()
