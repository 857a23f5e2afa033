"""The content of `maneuver/state` as plain values.

The maneuver driver publishes it, `tricycle drive` follows it, a bag keeps it for the judge.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from tricycle_core.stamps import SECOND


class PlaybackState(Enum):
    """Activity of the driver."""

    WAITING = "waiting"
    STARTING = "starting"
    RUNNING = "running"
    RETURNING = "returning"
    DONE = "done"
    ABORTED = "aborted"

    @property
    def driving(self) -> bool:
        """Whether commands are sent."""
        return self in (PlaybackState.STARTING, PlaybackState.RUNNING, PlaybackState.RETURNING)

    @property
    def ended(self) -> bool:
        """Whether a run is over, well or not."""
        return self in (PlaybackState.DONE, PlaybackState.ABORTED)


@dataclass(frozen=True)
class ManeuverState:
    """State of the driver and of its run.

    Attributes
    ----------
    state : PlaybackState
        Present activity of the driver.
    plan_id : str
        Identifier of the loaded plan; empty without one.
    start_time : int, optional
        When the newest run began [ns]; None before it.
    elapsed, duration : float
        Time since the start of the run, and length of the run [s].
    reason : str
        Why the run was aborted, or ended before its last command; otherwise empty.
    commander : str
        Name of the driver, as in its set-points; empty where it is not known.
    """

    state: PlaybackState
    plan_id: str = ""
    start_time: int | None = None
    elapsed: float = 0.0
    duration: float = 0.0
    reason: str = ""
    commander: str = ""

    def values(self) -> dict[str, str]:
        """Return the key-value pairs of the message."""
        start = self.start_time
        return {
            "state": self.state.value,
            "plan_id": self.plan_id,
            "start_time": "" if start is None else f"{start // SECOND}.{start % SECOND:09d}",
            "elapsed": f"{self.elapsed:.3f}",
            "duration": f"{self.duration:.3f}",
            "reason": self.reason,
            "commander": self.commander,
        }

    @classmethod
    def from_values(cls, values: Mapping[str, str]) -> ManeuverState:
        """Read the key-value pairs of a message; all but the state may be missing.

        Parameters
        ----------
        values : mapping of str to str
            Pairs as returned by `values`.

        Raises
        ------
        ValueError
            If the state is not one of `PlaybackState`, or a time is not a finite number.
        """
        start = values.get("start_time", "")
        elapsed, duration = (float(values.get(name, "0")) for name in ("elapsed", "duration"))
        if not (math.isfinite(elapsed) and math.isfinite(duration)):
            raise ValueError(f"elapsed {elapsed} s of {duration} s")
        return cls(
            PlaybackState(values.get("state")),
            values.get("plan_id", ""),
            _nanoseconds(start) if start else None,
            elapsed,
            duration,
            values.get("reason", ""),
            values.get("commander", ""),
        )


def _nanoseconds(seconds: str) -> int:
    """``"12.000000001"`` -> 12000000001, exactly."""
    whole, _, fraction = seconds.partition(".")
    nanoseconds = int(whole) * SECOND + int(fraction.ljust(9, "0")[:9] or 0)
    if not 0 <= nanoseconds < 2**63:
        raise ValueError(f"{seconds} s is not a time")
    return nanoseconds
