"""Levels of diagnostic_msgs/DiagnosticStatus, without ROS."""

from __future__ import annotations

import enum


class Level(enum.IntEnum):
    """How a part of the system is; the values are those of DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3

    @classmethod
    def of(cls, level: bytes) -> Level:
        """Return the level of a DiagnosticStatus; of others' bytes the lowest two bits count.

        Parameters
        ----------
        level : bytes
            As the message has it.
        """
        return cls(int.from_bytes(level, "little") & 3)
