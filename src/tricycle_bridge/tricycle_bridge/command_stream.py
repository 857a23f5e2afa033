"""The commanders' messages: which of them counts, and when a command is due on the links.

Times are seconds on the host's (ROS) clock.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

from tricycle_core.errors import LinkError

INPUT_AGE = 0.1
"""Largest age of a commander's message [s]; an older one is not forwarded."""

FASTEST_PERIOD = 0.0095
"""Shortest mean time between two commands [s].

The protocol allows 100 Hz. With a limit of exactly that, the jitter of a commander at 100 Hz would
add up to a lag that never goes away.
"""

JITTER = 1e-3
"""Time by which an action may be early [s], because the owner acts at discrete times."""


@dataclass(frozen=True)
class VehicleCommand:
    """What a commander wants the vehicle to do.

    Attributes
    ----------
    steering_motor_angle : float
        Angle of the steering motor [rad], left positive.
    speed : float
        Speed [m/s], forward positive.

    Raises
    ------
    LinkError
        A value is not finite.
    """

    steering_motor_angle: float
    speed: float

    def __post_init__(self) -> None:
        for name in ("steering_motor_angle", "speed"):
            if not math.isfinite(getattr(self, name)):
                raise LinkError(f"{name} is {getattr(self, name)}: must be a finite number")


class Source(enum.Enum):
    """Topic of a commander; `joint_commands` take precedence over `cmd_vel`."""

    JOINT_COMMANDS = "joint_commands"
    CMD_VEL = "cmd_vel"


@dataclass
class CommandCounters:
    """What happened to the commanders' messages.

    Attributes
    ----------
    accepted : int
        Messages that were taken.
    stale : int
        Messages without a stamp, or with one more than `INPUT_AGE` from the time of arrival.
    refused : int
        Messages that are not finite, lack a joint, or come from a commander without precedence.
    """

    accepted: int = 0
    stale: int = 0
    refused: int = 0


@dataclass
class _Input:
    command: VehicleCommand
    stamp: float
    source: Source


class CommandStream:
    """The newest valid message of the commanders, and when it is due to be sent."""

    def __init__(self) -> None:
        self.counters = CommandCounters()
        self._newest: _Input | None = None
        self._sent: tuple[_Input, bool] | None = None
        self._sent_at = -math.inf
        self._new_allowed_at = -math.inf

    def add(
        self, command: VehicleCommand, *, stamp: float, now: float, source: Source
    ) -> str | None:
        """Take a commander's message, or say why it is refused.

        Parameters
        ----------
        command : VehicleCommand
            What is wanted.
        stamp : float
            Time at which it was wanted [s]; 0 if the message has no stamp.
        now : float
            Time of arrival [s].
        source : Source
            Topic on which it came.

        Returns
        -------
        refusal : str or None
            Why it is refused; None if it was taken.
        """
        age = now - stamp
        if abs(age) > INPUT_AGE:
            self.counters.stale += 1
            if not stamp:
                return f"{source.value} has no time stamp"
            return f"{source.value} stamped {age:.2f} s ago, must be within {INPUT_AGE} s"
        if (
            source is Source.CMD_VEL
            and self._is_fresh(now)
            and self._newest is not None
            and self._newest.source is Source.JOINT_COMMANDS
        ):
            self.counters.refused += 1
            return f"{source.value} ignored while {Source.JOINT_COMMANDS.value} are coming"
        self.counters.accepted += 1
        self._newest = _Input(command, min(stamp, now), source)
        return None

    def newest(self, now: float) -> VehicleCommand | None:
        """Return the newest command, or None when it is older than `INPUT_AGE`."""
        return self._newest.command if self._newest is not None and self._is_fresh(now) else None

    def due(self, now: float, *, repeat_rate: float, enabled: bool) -> VehicleCommand | None:
        """Return the command that is to be sent now, and count it as sent.

        A new command, or a change of `enabled`, is due at once, at most 100 times per second.

        Parameters
        ----------
        now : float
            Present time [s].
        repeat_rate : float
            Rate at which the same command is sent again [Hz].
        enabled : bool
            Whether it is sent with the enable flag.
        """
        command = self.newest(now)
        if command is None or self._newest is None:
            return None
        if self._sent != (self._newest, enabled):
            if now < self._new_allowed_at - JITTER:
                return None
            # a message that came late does not delay the next one
            earliest = max(self._new_allowed_at, now - FASTEST_PERIOD)
            self._new_allowed_at = earliest + FASTEST_PERIOD
        elif now < self._sent_at + 1.0 / repeat_rate - JITTER:
            return None
        self._sent, self._sent_at = (self._newest, enabled), now
        return command

    def clear(self) -> None:
        """Forget the commands, after the clock jumped back."""
        self._newest = None
        self._sent_at = self._new_allowed_at = -math.inf

    def _is_fresh(self, now: float) -> bool:
        return self._newest is not None and now - self._newest.stamp <= INPUT_AGE + JITTER
