"""Joint readings of the two boards, joined where they were measured in the same tick.

Each board reports its joint once per tick on a line of its own. On a busy machine a port delivers
many ticks at once, so a reading waits for its partner for as long as the partner's link is up.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from tricycle_bridge.plc_link.link import Telemetry
from tricycle_bridge.protocol.messages import (
    Board,
    DriveLimits,
    SteerLimits,
    SteerState,
)
from tricycle_bridge.protocol.units import ANGLE_UNIT, SPEED_UNIT, STEER_RATE_UNIT, TRAVEL_UNIT
from tricycle_core.joints import JOINTS, REAR_WHEEL_JOINT, STEERING_JOINT
from tricycle_core.timing import TICK


class JointReading(NamedTuple):
    """Measured state of one joint.

    Attributes
    ----------
    name : str
        One of `tricycle_core.joints.JOINTS`.
    position : float
        Angle of the joint [rad].
    velocity : float
        Angular velocity [rad/s].
    """

    name: str
    position: float
    velocity: float


class JointReadings(NamedTuple):
    """Joints measured at the same time.

    Attributes
    ----------
    stamp : float
        Time of measurement on the host's clock [s].
    joints : tuple of JointReading
        Both joints in the order of `JOINTS`, or the one whose board has no partner.
    """

    stamp: float
    joints: tuple[JointReading, ...]


def joint_reading(
    telemetry: Telemetry,
    limits: SteerLimits | DriveLimits | None,
    tyre_radius: float,
    hall_pulse: float,
) -> JointReading | None:
    """Return the joint state in a board's telemetry.

    Parameters
    ----------
    telemetry : SteerState or DriveState
        State frame of the board.
    limits : SteerLimits or DriveLimits, optional
        The board's answer to LIMITS_REQ; the drive's hold the travel per hall pulse that the board
        counts its speed with, which is its own until it is set up.
    tyre_radius : float
        Radius of the rear wheel [m].
    hall_pulse : float
        Travel per hall pulse [m].

    Returns
    -------
    reading : JointReading or None
        None while the travel per hall pulse is not known.
    """
    if isinstance(telemetry, SteerState):
        return JointReading(
            STEERING_JOINT, telemetry.angle * ANGLE_UNIT, telemetry.rate * STEER_RATE_UNIT
        )
    if not isinstance(limits, DriveLimits):
        return None
    return JointReading(
        REAR_WHEEL_JOINT,
        telemetry.hall_count * hall_pulse / tyre_radius,
        telemetry.speed * SPEED_UNIT * hall_pulse / (limits.pulse * TRAVEL_UNIT) / tyre_radius,
    )


_Measured = tuple[float, JointReading]  # time of measurement [s]


class JointPairing:
    """Joins the readings of two boards; a board whose partner is not connected reports alone."""

    def __init__(self) -> None:
        self._unpaired: dict[Board, deque[_Measured]] = {
            Board.STEER: deque(),
            Board.DRIVE: deque(),
        }
        self._readings: list[JointReadings] = []

    def add(self, board: Board, reading: JointReading, stamp: float, *, partner_up: bool) -> None:
        """Take one board's reading.

        Parameters
        ----------
        board : Board
            Board that measured it.
        reading : JointReading
            Measured state of its joint.
        stamp : float
            Time of measurement on the host's clock [s].
        partner_up : bool
            Whether the other board's link is up.
        """
        partner = Board.DRIVE if board is Board.STEER else Board.STEER
        own, partners = self._unpaired[board], self._unpaired[partner]
        while partners and not _may_be_of_one_tick(partners, stamp):
            self._report(*partners.popleft())
        if not partners:
            own.append((stamp, reading))
            while own and not partner_up:
                self._report(*own.popleft())
        elif partners[0][0] >= stamp + TICK:
            self._report(stamp, reading)
        else:
            measured, other = partners.popleft()
            self._report(stamp, reading, _extrapolated(other, stamp - measured))

    def take(self) -> list[JointReadings]:
        """Return the joints measured since the last call."""
        readings, self._readings = self._readings, []
        return readings

    def clear(self) -> None:
        """Forget the readings that wait for a partner."""
        for waiting in self._unpaired.values():
            waiting.clear()

    def _report(self, stamp: float, *joints: JointReading) -> None:
        in_order = joints if joints[0].name == JOINTS[0] else joints[::-1]
        self._readings.append(JointReadings(stamp, in_order))


def _may_be_of_one_tick(waiting: deque[_Measured], stamp: float) -> bool:
    """Whether the oldest of these is at most a tick older than `stamp` and the next no nearer."""
    first = waiting[0][0]
    if first <= stamp - TICK:
        return False
    return len(waiting) == 1 or abs(first - stamp) <= abs(waiting[1][0] - stamp)


def _extrapolated(joint: JointReading, seconds: float) -> JointReading:
    """Return a reading a few milliseconds later or earlier, at constant velocity."""
    return JointReading(joint.name, joint.position + joint.velocity * seconds, joint.velocity)
