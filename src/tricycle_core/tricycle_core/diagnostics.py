"""Levels and key-value pairs of diagnostic_msgs/DiagnosticStatus, without ROS."""

from __future__ import annotations

import enum
from typing import Any


class Level(enum.IntEnum):
    """Condition of a part of the system; the values are those of DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3

    @classmethod
    def of(cls, level: bytes) -> Level:
        """Return the level of a DiagnosticStatus; only the lowest two bits of the byte count.

        Parameters
        ----------
        level : bytes
            Field `level` of the message, one byte.
        """
        return cls(int.from_bytes(level, "little") & 3)


def values_of(status: Any) -> dict[str, str]:
    """Return the key-value pairs of a DiagnosticStatus.

    Parameters
    ----------
    status : DiagnosticStatus message
        Message as read by rosbags or rclpy.
    """
    return {pair.key: pair.value for pair in status.values}
