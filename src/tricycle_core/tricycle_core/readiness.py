"""Whether the vehicle accepts commands: what `vehicle/state` says, as plain values.

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
        Why not, for a person; empty while armed.
    commander : str
        Name of the commander that is obeyed; empty while there is none.
    """

    armed: bool
    reason: str = ""
    commander: str = ""

    def values(self) -> dict[str, str]:
        """Return the key-value pairs of the message."""
        armed = "true" if self.armed else "false"
        return {"armed": armed, "reason": self.reason, "commander": self.commander}

    @classmethod
    def from_values(cls, values: Mapping[str, str]) -> Readiness:
        """Read the key-value pairs of a message; what is missing means that it is not armed.

        Parameters
        ----------
        values : mapping of str to str
            As `values` returns them.
        """
        return cls(
            values.get("armed") == "true", values.get("reason", ""), values.get("commander", "")
        )
