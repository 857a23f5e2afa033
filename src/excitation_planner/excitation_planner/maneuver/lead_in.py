"""The lead-in: the straight on which a vehicle gets up to speed before the maneuver proper.

Every family begins with a run-in. With a lead-in the straight is longer, if that is wanted, and the
driver keeps the vehicle on its line, closed loop; the maneuver proper is then begun at speed, and
driven open loop.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from excitation_planner.box import Box
from excitation_planner.maneuver.family import (
    COMMAND_TICKS,
    PATH_SPACING,
    DrivenPath,
    ManeuverFamily,
)
from tricycle_core.errors import PlanError
from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import Vehicle

STRAIGHT = 0.01
"""Steering motor angle up to which commands lead straight ahead [rad].

From 0, or from where the vehicle drives straight: a steering that is mounted askew is steered back.
"""
ANGLES = np.linspace(-0.3, 0.3, 7)
"""Steering motor angles between which the angle of straight driving is interpolated [rad]."""

LONGEST = 100.0
"""Longest straight that may be asked for [m]."""


@dataclass(frozen=True)
class LedInFamily:
    """A maneuver family whose maneuvers begin with a lead-in.

    Attributes
    ----------
    family : ManeuverFamily
        Family whose maneuvers get a lead-in.
    length : float
        Length of the straight before the family's own run-in [m].

    Raises
    ------
    PlanError
        If the length is not from 0 to `LONGEST`.
    """

    family: ManeuverFamily
    length: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.length <= LONGEST:
            raise PlanError(f"lead-in {self.length:g} m must be from 0 to {LONGEST:g} m")

    @property
    def name(self) -> str:
        """Name of the family."""
        return self.family.name

    @property
    def operation(self) -> Box:
        """Ranges of the family."""
        return self.family.operation

    def drive(self, x: FloatArray, vehicle: Vehicle) -> DrivenPath | Commands:
        """Return what the family drives at x, after the longer straight.

        Parameters
        ----------
        x : ndarray of float, shape (l,)
            Operation parameters.
        vehicle : Vehicle
            Vehicle; only its nominal values count.
        """
        drive = self.family.drive(x, vehicle)
        if isinstance(drive, Commands):
            return _longer(drive, vehicle, self.length)
        steps = round(self.length / PATH_SPACING)
        before = drive.x[0] + PATH_SPACING * np.arange(steps)
        return DrivenPath(
            np.concatenate([before, drive.x + steps * PATH_SPACING]),
            np.concatenate([np.zeros(steps), drive.y]),
            drive.speed,
            drive.length + steps * PATH_SPACING,
        )


def with_lead_in(families: Sequence[ManeuverFamily], length: float) -> tuple[ManeuverFamily, ...]:
    """Return the families with a lead-in.

    Parameters
    ----------
    families : sequence of ManeuverFamily
        Families without a lead-in.
    length : float
        Length of the straight before their own run-ins [m].

    Raises
    ------
    PlanError
        If the length is not from 0 to `LONGEST`.
    """
    return tuple(LedInFamily(family, length) for family in families)


def lead_in_of(commands: Commands, vehicle: Vehicle) -> float:
    """Return for how long commands lead straight ahead [s]: until the first steering.

    Parameters
    ----------
    commands : Commands
        Commands of a maneuver.
    vehicle : Vehicle
        Vehicle; only its nominal values count.
    """
    return float(commands.time[_first_steered(commands, vehicle)])


def straight_on(vehicle: Vehicle) -> float:
    """Return the steering motor angle at which a vehicle drives straight on [rad].

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle; only its nominal values count.
    """
    from tricycle_sim.vehicle.kinematics import road_angles  # the help of `plan` needs no numba

    return float(np.interp(0.0, road_angles(vehicle, ANGLES), ANGLES))


def _first_steered(commands: Commands, vehicle: Vehicle) -> int:
    """Row of the first steering; the last one without any."""
    motor = commands.steering_motor_angle
    turned = np.fmin(np.abs(motor), np.abs(motor - straight_on(vehicle)))
    steered = np.flatnonzero(turned > STRAIGHT)
    return int(steered[0]) if len(steered) else len(commands.time) - 1


def _longer(commands: Commands, vehicle: Vehicle, length: float) -> Commands:
    """Commands with a straight put in before the first steering."""
    row, period = _first_steered(commands, vehicle), COMMAND_TICKS * TICK
    pace = float(commands.speed[max(row - 1, 0)])
    if length > 0.0 and pace <= 0.0:
        raise PlanError("a lead-in needs a maneuver that is driven forwards before it steers")
    more = round(length / (pace * period)) if length > 0.0 else 0
    return Commands(
        np.concatenate(
            [
                commands.time[:row],
                commands.time[row] + period * np.arange(more),
                commands.time[row:] + period * more,
            ]
        ),
        np.insert(commands.steering_motor_angle, [row] * more, 0.0),
        np.insert(commands.speed, [row] * more, pace),
    )
