"""Replay, open loop: the trajectory error of perturbed vehicles driving one command history."""

from collections import OrderedDict
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from excitation_planner.area.room import Room
from excitation_planner.maneuver import ManeuverFamily
from excitation_planner.maneuver.family import (
    DrivenPath,
    kept_margin,
    path_point,
    steering_lock,
)
from excitation_planner.maneuver.tracking import track
from excitation_planner.plan import Reference
from excitation_planner.planning.shaping import check_motor
from excitation_planner.trajectory_error import NominalTrajectory
from tricycle_bridge.protocol.units import ANGLE_UNIT, SPEED_UNIT
from tricycle_core.errors import InfeasibleManeuver, PlanError
from tricycle_core.quantities import FloatArray
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.batch import CommandedBatch
from tricycle_sim.vehicle.feasibility import Feasibility
from tricycle_sim.vehicle.planar import PlanarBlock, simulate_planar

KEPT_RUNS = 4
"""Nominal runs that are kept: the search asks for the same x once per batch of samples."""


@dataclass(frozen=True)
class NominalRun:
    """The nominal vehicle's drive of a maneuver: commands, path and trajectories.

    Attributes
    ----------
    commands : Commands
        Steer and drive commands of the family, or of the tracked path.
    path : ndarray of float, shape (m, 2)
        Path of the unsteered axle's ground point [m].
    reference : Reference
        Trajectory of the nominal vehicle replaying the commands.
    nominal : NominalTrajectory
        The same trajectory on the simulation's grid, as TE needs it.
    """

    commands: Commands
    path: FloatArray
    reference: Reference
    nominal: NominalTrajectory


def replayed_errors(
    vehicle: Vehicle, run: NominalRun, parameters: FloatArray, *, threads: int | None = 1
) -> FloatArray:
    """Return TE (n,) [m²] of perturbed vehicles that replay the commands of a run.

    NaN where a vehicle rolled over.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with its nominal values.
    run : NominalRun
        Nominal run, whose commands are replayed.
    parameters : ndarray of float, shape (n, k)
        Unknown parameters.
    threads : int, optional
        Number of threads; None: one per processor. A search that evaluates maneuvers in parallel
        takes one each.
    """
    errors = np.empty(len(parameters))

    def reduce(first: int, block: PlanarBlock) -> None:
        te = run.nominal.error(block.x, block.y, block.vx_world, block.vy_world)
        te[block.feasibility.rolled_over.happened] = np.nan
        errors[first : first + len(te)] = te

    simulate_planar(vehicle, run.commands, parameters, reduce, threads=threads)
    return errors


def nominal_run(
    vehicle: Vehicle, family: ManeuverFamily, x: FloatArray, room: Room | None = None
) -> NominalRun:
    """Return the nominal vehicle's drive of a maneuver; a path is tracked first.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with its nominal values; with a room, the ranges of its parameters count too.
    family : ManeuverFamily
        Family of the maneuver.
    x : ndarray of float, shape (l,)
        Operation parameters.
    room : Room, optional
        Area, footprint and position noise that the maneuver must fit with every vehicle of the
        ranges.

    Raises
    ------
    InfeasibleManeuver
        If the nominal vehicle cannot drive it, or it does not fit; the message is the reason.
    PlanError
        If no maneuver can be planned for the vehicle: its motor holds no speed.
    """
    drive, commands = _driven(vehicle, family, x)
    batch = CommandedBatch(vehicle, commands)
    run = batch.run(vehicle.nominal_point()[np.newaxis], ("x", "y", "yaw", "vx_world", "vy_world"))
    _check(vehicle, commands, run.feasibility, room)
    own_x, own_y, own_yaw, vx, vy = (column[0] for column in run.columns.values())
    reference = Reference(batch.time, own_x, own_y, own_yaw)
    return NominalRun(
        commands=commands,
        path=_driven_path(vehicle, reference)
        if isinstance(drive, Commands)
        else np.column_stack([drive.x, drive.y]),
        reference=reference,
        nominal=NominalTrajectory(batch.time, own_x, own_y, vx, vy),
    )


def nominal_commands(
    vehicle: Vehicle, family: ManeuverFamily, x: FloatArray, room: Room | None = None
) -> Commands:
    """Return the commands of a maneuver; unlike `nominal_run`, without its trajectories.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with its nominal values; with a room, the ranges of its parameters count too.
    family : ManeuverFamily
        Family of the maneuver.
    x : ndarray of float, shape (l,)
        Operation parameters.
    room : Room, optional
        Area, footprint and position noise that the maneuver must fit.

    Raises
    ------
    InfeasibleManeuver, PlanError
        As `nominal_run`.
    """
    _, commands = _driven(vehicle, family, x)
    nominal = CommandedBatch(vehicle, commands).run(vehicle.nominal_point()[np.newaxis], ("x",))
    _check(vehicle, commands, nominal.feasibility, room)
    return commands


def driven_commands(vehicle: Vehicle, family: ManeuverFamily, x: FloatArray) -> Commands:
    """Return the commands of a maneuver, whether or not the nominal vehicle can drive them.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle; only its nominal values count.
    family : ManeuverFamily
        Family of the maneuver.
    x : ndarray of float, shape (l,)
        Operation parameters.

    Raises
    ------
    InfeasibleManeuver
        If there are none: the vehicle cannot follow the path, or its steering does not reach.
    PlanError
        If no maneuver can be planned for the vehicle: its motor holds no speed.
    """
    return _driven(vehicle, family, x)[1]


def _driven(
    vehicle: Vehicle, family: ManeuverFamily, x: FloatArray
) -> tuple[DrivenPath | Commands, Commands]:
    """Path or commands of a family, and the commands that are sent."""
    check_motor(vehicle)
    try:
        drive = family.drive(x, vehicle)
    except (PlanError, ValueError, ArithmeticError) as error:  # in ranges that the user has widened
        raise InfeasibleManeuver(str(error)) from error
    if isinstance(drive, Commands):
        _check_angles(vehicle, drive)
        commands = _as_sent(drive)
    else:
        tracking = track(vehicle, drive)
        if tracking.infeasible:
            raise InfeasibleManeuver(tracking.infeasible)
        commands = tracking.commands
    return drive, commands


def _check(
    vehicle: Vehicle, commands: Commands, feasibility: Feasibility, room: Room | None
) -> None:
    """Raise unless the nominal vehicle can drive the commands, and they fit the room."""
    if not feasibility.feasible[0]:
        raise InfeasibleManeuver("; ".join(feasibility.reasons(0)))
    if room is not None:
        room.check(vehicle, commands)


def _check_angles(vehicle: Vehicle, commands: Commands) -> None:
    angles = np.abs(commands.steering_motor_angle)
    row = int(np.argmax(angles))
    if angles[row] > steering_lock(vehicle) + 0.5 * ANGLE_UNIT:
        raise InfeasibleManeuver(
            f"the steering turns to {angles[row]:.4f} rad at {commands.time[row]:.2f} s: "
            f"{kept_margin(vehicle)}"
        )


def _as_sent(commands: Commands) -> Commands:
    """Commands in the units of the protocol, as tracking gives them."""
    return Commands(
        commands.time,
        np.round(commands.steering_motor_angle / ANGLE_UNIT) * ANGLE_UNIT,
        np.round(commands.speed / SPEED_UNIT) * SPEED_UNIT,
    )


def _driven_path(vehicle: Vehicle, motion: Reference) -> FloatArray:
    """Path (m, 2) of the unsteered axle's ground point, a point every 0.1 s."""
    b = path_point(vehicle)
    path = np.column_stack([motion.x + b * np.cos(motion.yaw), motion.y + b * np.sin(motion.yaw)])
    return path[::10]


@dataclass(frozen=True)
class ReplayedTrajectoryError:
    """The simulator f(x, p) = TE of the method (Eq. 2), for one vehicle and family.

    Calling it with operation parameters x (l,) and unknown parameters (n, k) gives TE (n,) in m^2,
    NaN where a vehicle rolled over; it raises `InfeasibleManeuver` where the nominal vehicle cannot
    drive x.
    """

    vehicle: Vehicle
    family: ManeuverFamily
    room: Room | None = None
    _runs: OrderedDict[bytes, NominalRun] = field(
        default_factory=OrderedDict, init=False, repr=False, compare=False
    )

    def __call__(self, x: FloatArray, parameters: FloatArray) -> FloatArray:
        """TE (n,) of the samples."""
        return replayed_errors(self.vehicle, self.nominal(x), parameters)

    def nominal(self, x: FloatArray) -> NominalRun:
        """The nominal run at x, kept for the next calls."""
        key = np.asarray(x, dtype=float).tobytes()
        run = self._runs.get(key)
        if run is None:
            run = self._runs[key] = nominal_run(self.vehicle, self.family, x, self.room)
            with suppress(KeyError):  # another thread may have dropped them
                while len(self._runs) > KEPT_RUNS:
                    self._runs.popitem(last=False)
        return run
