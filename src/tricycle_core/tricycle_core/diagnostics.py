"""Levels of diagnostic_msgs/DiagnosticStatus, without ROS."""

import enum


class Level(enum.IntEnum):
    """How a part of the system is; the values are those of DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3
