"""The commanders' messages: whose command counts, and when a command is due on the links.

Times are seconds on the bridge's clock.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

from tricycle_core.errors import LinkError

INPUT_AGE = 0.1
"""Largest age of a commander's message [s]; an older one is not forwarded."""

INPUT_LEAD = 0.02
"""Largest time by which a message may be stamped ahead of its arrival [s]."""

FASTEST_PERIOD = 0.0095
"""Shortest mean time between two commands [s].

The protocol allows 100 Hz. With a limit of exactly that, the jitter of a commander at 100 Hz would
add up to a lag that never goes away.
"""

JITTER = 1e-3
"""Time by which an action may be early [s], because the owner acts at discrete times."""

CONFLICT_TIME = 1.0
"""Time for which a second commander is reported after its last message [s]."""


@dataclass(frozen=True)
class VehicleCommand:
    """Command of a commander for the vehicle.

    Attributes
    ----------
    steering_motor_angle : float
        Angle of the steering motor [rad], left positive.
    speed : float
        Speed [m/s], forward positive.

    Raises
    ------
    LinkError
        If a value is not finite.
    """

    steering_motor_angle: float
    speed: float

    def __post_init__(self) -> None:
        for name in ("steering_motor_angle", "speed"):
            if not math.isfinite(getattr(self, name)):
                raise LinkError(f"{name} is {getattr(self, name)}: must be a finite number")


class Source(enum.Enum):
    """Topic of a commander."""

    JOINT_COMMANDS = "joint_commands"
    CMD_VEL = "cmd_vel"


class Commander(NamedTuple):
    """Sender of commands.

    Attributes
    ----------
    source : Source
        Topic on which the commands come.
    name : str
        Name that the commander gives itself; empty if it gives none.
    """

    source: Source
    name: str = ""

    def __str__(self) -> str:
        unnamed = "cmd_vel" if self.source is Source.CMD_VEL else f"unnamed {self.source.value}"
        return f"{self.source.value} of {self.name}" if self.name else unnamed


@dataclass
class CommandCounters:
    """Numbers of the commanders' messages, by what happened to them.

    Attributes
    ----------
    accepted : int
        Messages that were taken.
    stale : int
        Messages without a stamp, older than `INPUT_AGE` or more than `INPUT_LEAD` ahead.
    refused : int
        Messages with a command that is impossible, or from a second commander.
    """

    accepted: int = 0
    stale: int = 0
    refused: int = 0


class _Input(NamedTuple):
    stamp: float
    command: VehicleCommand
    commander: Commander
    refused: str = ""  # why it is not the command that was sent


_Sent = tuple[_Input | None, bool]  # None: standstill of the bridge; with the enable flag or not


class CommandStream:
    """The newest valid message of the commanders, and when it is due to be sent.

    Attributes
    ----------
    counters : CommandCounters
        Numbers of messages, by what happened to them.
    commander : Commander or None
        Who commands the armed vehicle; only `release` and `unlock` change it.
    """

    def __init__(self) -> None:
        self.counters = CommandCounters()
        self.commander: Commander | None = None
        self._locking = False
        self._released: Commander | None = None
        self._released_heard_at = -math.inf
        self._conflict = ""
        self._conflict_at = -math.inf
        self._newest: _Input | None = None
        self._begun_at = -math.inf  # commands of before do not count
        self._sent: _Sent | None = None
        self._sent_at = -math.inf
        self._new_allowed_at = -math.inf

    # ---- whose command counts ----

    def begin(self, now: float) -> None:
        """Let only commands of from now on count, because the vehicle is being armed.

        The last command of an earlier drive may have another steering angle than the vehicle.

        Parameters
        ----------
        now : float
            Present time [s].
        """
        self._begun_at = now

    def lock(self) -> None:
        """Let whoever commands next be the only commander, because the vehicle is armed."""
        self._locking = True

    def unlock(self) -> None:
        """Let everybody command again, because the vehicle is not armed."""
        self._locking = False
        self.commander = self._released = None

    def release(self, now: float) -> None:
        """Let another commander take over; the present one may only after a pause.

        Parameters
        ----------
        now : float
            Present time [s].
        """
        self._released, self._released_heard_at = self.commander, now
        self.commander = self._newest = None

    def conflict(self, now: float) -> str | None:
        """Return which two commanders contradict each other, if any do."""
        return self._conflict if now - self._conflict_at <= CONFLICT_TIME else None

    def _contradiction(self, commander: Commander, now: float) -> str | None:
        """Return why a commander may not command; make it the vehicle's if it may."""
        if not self._locking or commander == self.commander:
            return None
        if self.commander is not None:
            self._conflict = f"{commander} is refused: {self.commander} commands the vehicle"
            self._conflict_at = now
            return self._conflict
        if commander == self._released:
            pause, self._released_heard_at = now - self._released_heard_at, now
            if pause <= INPUT_AGE:
                return (
                    f"{commander} is refused: it released the vehicle, and may command again "
                    f"after a pause of {INPUT_AGE} s"
                )
        self.commander = commander
        return None

    # ---- which command counts ----

    def add(
        self, command: VehicleCommand, *, stamp: float, now: float, commander: Commander
    ) -> str | None:
        """Take a commander's message, or return why it is refused.

        Parameters
        ----------
        command : VehicleCommand
            Command in the message.
        stamp : float
            Stamp of the message [s]; 0 if it has none.
        now : float
            Time of arrival [s].
        commander : Commander
            Sender of the message.

        Returns
        -------
        refusal : str or None
            Why it is refused; None if it was taken.
        """
        refusal = self._admit(command, stamp, now, commander)
        if refusal is None:
            self.counters.accepted += 1
        return refusal

    def refuse(
        self,
        standstill: VehicleCommand,
        reason: str,
        *,
        stamp: float,
        now: float,
        commander: Commander,
    ) -> str | None:
        """Take a message that cannot be obeyed as a command to stand still.

        Parameters
        ----------
        standstill : VehicleCommand
            Command that takes its place.
        reason : str
            Why the message cannot be obeyed.
        stamp, now : float
            Time at which the message was sent, time of arrival [s].
        commander : Commander
            Sender of the message.

        Returns
        -------
        refusal : str or None
            Why not even that is taken from the commander; None if it was.
        """
        refusal = self._admit(standstill, stamp, now, commander, reason)
        if refusal is None:
            self.counters.refused += 1
        return refusal

    def _admit(
        self,
        command: VehicleCommand,
        stamp: float,
        now: float,
        commander: Commander,
        refused: str = "",
    ) -> str | None:
        """Make a command the newest one, or count and say why its commander is not heard."""
        if (refusal := _stamp_refusal(now - stamp)) is not None:
            self.counters.stale += 1
            return f"{commander} {'has no time stamp' if not stamp else refusal}"
        if (refusal := self._contradiction(commander, now)) is not None:
            self.counters.refused += 1
            return refusal
        self._newest = _Input(min(stamp, now), command, commander, refused)
        return None

    def newest(self, now: float) -> VehicleCommand | None:
        """Return the newest command, or None when it is older than `INPUT_AGE`."""
        return self._newest.command if self._newest is not None and self._is_fresh(now) else None

    def refusal(self, now: float) -> str:
        """Return why the newest command is standstill in place of what was sent; empty if not."""
        return self._newest.refused if self._newest is not None and self._is_fresh(now) else ""

    @property
    def last(self) -> VehicleCommand | None:
        """The newest command however old it is."""
        return None if self._newest is None else self._newest.command

    @property
    def last_commander(self) -> Commander | None:
        """Who sent the newest command, however old it is."""
        return None if self._newest is None else self._newest.commander

    def due(
        self,
        now: float,
        *,
        repeat_rate: float,
        enabled: bool,
        standstill: Callable[[], VehicleCommand | None] = lambda: None,
        standstill_rate: float = 50.0,
    ) -> VehicleCommand | None:
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
        standstill : callable, optional
            Returns what is sent while no commander's command is fresh.
        standstill_rate : float
            Rate at which it is sent [Hz].
        """
        newest = self._newest if self._is_fresh(now) else None
        command = standstill() if newest is None else newest.command
        if command is None:
            return None
        if self._sent != (newest, enabled):
            if now < self._new_allowed_at - JITTER:
                return None
            # a message that came late does not delay the next one
            earliest = max(self._new_allowed_at, now - FASTEST_PERIOD)
            self._new_allowed_at = earliest + FASTEST_PERIOD
        else:
            rate = standstill_rate if newest is None else repeat_rate
            if now < self._sent_at + 1.0 / rate - JITTER:
                return None
        self._sent, self._sent_at = (newest, enabled), now
        return command

    def clear(self) -> None:
        """Forget the commands, after the clock jumped back."""
        self._newest = None
        self._begun_at = self._sent_at = self._new_allowed_at = -math.inf
        self._conflict_at = self._released_heard_at = -math.inf

    def _is_fresh(self, now: float) -> bool:
        newest = self._newest
        if newest is None or newest.stamp <= self._begun_at:
            return False
        return now - newest.stamp <= INPUT_AGE + JITTER


def _stamp_refusal(age: float) -> str | None:
    if age > INPUT_AGE:
        return (
            f"is stamped {age:.2f} s ago, must be within {INPUT_AGE} s: "
            "late, or its computer's clock is behind"
        )
    if age < -INPUT_LEAD:
        return (
            f"is stamped {-age:.2f} s ahead, must be within {INPUT_LEAD} s: "
            "its computer's clock is ahead"
        )
    return None
