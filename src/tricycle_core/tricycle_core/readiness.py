"""Whether the vehicle accepts commands: the content of `vehicle/state` as plain values.

The bridge publishes it, the maneuver driver obeys it, a bag keeps it for the judge.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

TOPIC = "vehicle/state"
"""diagnostic_msgs/DiagnosticStatus, latched: on every change and every `PERIOD`."""

ARMED_TOPIC = "vehicle/armed"
"""std_msgs/Bool, latched: the first of its values, with every message of `TOPIC`."""

PERIOD = 0.5
"""Longest time between two messages [s]."""


class Readiness(NamedTuple):
    """Whether both boards accept commands.

    Attributes
    ----------
    armed : bool
        Whether both boards are armed and the bridge forwards commands.
    reason : str
        Why the vehicle is not armed, for a person; empty while armed.
    commander : str
        Name of the commander that is obeyed; empty while there is none.
    refused : str
        Why the vehicle is to stand still in place of its newest command; empty if that is obeyed.
    """

    armed: bool
    reason: str = ""
    commander: str = ""
    refused: str = ""

    def values(self) -> dict[str, str]:
        """Return the key-value pairs of the message."""
        armed = "true" if self.armed else "false"
        return {
            "armed": armed,
            "reason": self.reason,
            "commander": self.commander,
            "refused": self.refused,
        }

    @classmethod
    def from_values(cls, values: Mapping[str, str]) -> Readiness:
        """Read the key-value pairs of a message; if `armed` is missing, the vehicle is not armed.

        Parameters
        ----------
        values : mapping of str to str
            Pairs as returned by `values`.
        """
        return cls(
            values.get("armed") == "true",
            values.get("reason", ""),
            values.get("commander", ""),
            values.get("refused", ""),
        )
