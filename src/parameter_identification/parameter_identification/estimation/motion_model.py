"""Motion of a vehicle on a drive, with the steps of its finite differences.

One batch of the simulator gives the motion and its differences: the vehicle of the moment, one per
parameter, one per nuisance that it is simulated with; eight lanes cost what one does. The drive's
dead time, common to a batch, takes another one. The other nuisances change this motion afterwards
(`_distorted`), and are differentiated by doing so once more.

All variables are scaled to be of the order 1: parameters in their ranges (0 to 1), a nuisance in
the standard deviation of its prior. Letters of shapes: `k` parameters, `q` nuisances of the motion,
`n` lanes, `t` ticks.
"""

import dataclasses
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from parameter_identification.drives.following import (
    curvature_per_angle,
    has_gains,
    setpoints_for_speed,
    setpoints_for_steering,
    with_stiff_loop,
)
from parameter_identification.drives.measured import Input, MeasuredDrive, Sensor
from parameter_identification.drives.pose_filter import low_passed
from parameter_identification.estimation.deviations import deviated
from parameter_identification.estimation.motions import Batch, Motions, Simulator
from parameter_identification.estimation.nuisance import InUnits, Nuisance
from parameter_identification.estimation.whiteness import resolution
from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.effects import (
    DRIVE_DEAD_TIME,
    OF_SERVO,
    OF_SPEED_LOOP,
    SERVO_DEAD_TIME,
    SPEED_DEVIATION,
    START_DEVIATION,
    TURN_DEVIATION,
    Effect,
    affected_constants,
    as_sensed,
    with_effects,
)
from tricycle_sim.vehicle import Vehicle

STEP = 1e-4  # of the finite differences by parameters, in ranges
SPEED_STEP = 1e-3  # m/s, of those by the start speed
ERROR_STEP = 0.01  # standard deviations, of those by the error of a speed that is followed
RESTING = 0.05  # m/s, below which a drive starts from rest, and has no path to be followed
OF_INPUT = {Input.STEERING: OF_SERVO, Input.SPEED: OF_SPEED_LOOP}
"""Names of the effects of how each input comes about: without effect where it is measured."""

START = np.array([0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0])
"""Knots of the deviation of a start from rest [s]: boards and motor are known least at low speed.

It vanishes at the first and at the last.
"""

# Standard deviations of the nuisances' priors
START_SPEED_STD = 0.02  # m/s: the vehicle should stand still, or its speed was measured
INPUT_DELAY_STD = 0.01  # s, of a measured input's: mostly one computer stamps both
LEAST_OFF, LEAST_SPEED_OFF = 5e-4, 2e-4  # rad, of a measured steering angle; m/s
POSE_FILTER_STD = 0.05  # s, as that of a delay
START_SPEED = "start speed"
STEERING_DELAY, STEERING_ZERO, STEERING_GAIN = (
    f"{what} of the measured steering" for what in ("delay", "zero", "gain")
)
SPEED_DELAY, SPEED_ZERO = (f"{what} of the measured speed" for what in ("delay", "zero"))
POSE_FILTER = "pose filter"
SPEED_ERROR, TURN_ERROR = "error of the followed speed", "error of the followed steering"
_SPACING = {SPEED_DEVIATION: 1.0, TURN_DEVIATION: 1.0, SPEED_ERROR: 0.25, TURN_ERROR: 0.25}
"""Time between the values of a deviation or an error, linear between them [s]."""
BEFORE = {SPEED_ERROR: 0.0, TURN_ERROR: 0.5}
"""Time before the first sample from which an error acts [s]: the body turns as it was steered."""
_STEPS = {
    START_SPEED: SPEED_STEP,
    STEERING_DELAY: 1e-3,
    STEERING_ZERO: 1e-4,
    STEERING_GAIN: 1e-3,
    SPEED_DELAY: 1e-3,
    SPEED_ZERO: 1e-4,
}
"""Steps of the finite differences by nuisances that are no effects, in their units."""

_OF_SOME_DRIVES = {
    Sensor.LATERAL_ACCELERATION: ("lateral_acceleration",),
    Sensor.MOTOR_TORQUE: ("motor_torque",),
}
"""Columns of the simulation that sensors see which not every drive has; wheels have their own."""


class _Way(IntEnum):
    """Way to find the motion with a step of a nuisance, in the order of the lanes."""

    SIMULATED = 0  # in the batch
    DELAYED = 1  # in one of its own, as the drive's dead time is the same in all of a batch
    DISTORTED = 2  # of the motion without the step, in closed form


@dataclass(frozen=True, eq=False)
class _Followed:
    """An input that moves as measured.

    Attributes
    ----------
    commanded, following : ndarray of float, shape (t - 1,)
        Set-points on the ticks: those commanded, and those that give what was measured.
    moves : ndarray of bool, shape (t - 1,)
        True where an error of the sensor's zero acts.
    """

    commanded: FloatArray
    following: FloatArray
    moves: NDArray[np.bool_]

    def added(self, late: FloatArray, zero: FloatArray, gain: FloatArray) -> FloatArray:
        """Return the additions (n, t) to the set-points by errors of the sensor, (n,) each."""
        ticks = TICK * np.arange(len(self.commanded))
        rows = np.array([np.interp(ticks + delay, ticks, self.following) for delay in late])
        wanted = rows * (1.0 + gain[:, np.newaxis]) + zero[:, np.newaxis] * self.moves
        return np.pad(wanted - self.commanded, ((0, 0), (0, 1)), mode="edge")


@dataclass(frozen=True, eq=False)
class _Differences:
    """Finite differences of the motion by e nuisances, in the order of their lanes.

    Attributes
    ----------
    lanes : ndarray of int, shape (e,)
        Indices of the nuisances.
    simulated : int
        Number of the first ones, which are in the batch.
    steps : ndarray of float, shape (e,)
        Lengths of the steps, in standard deviations of the priors.
    inwards : ndarray of bool, shape (e,)
        True where steps are towards the mean, beyond which there may be bounds; a vehicle that
        rests never steps backwards.
    """

    lanes: NDArray[np.int64]
    simulated: int
    steps: FloatArray
    inwards: NDArray[np.bool_]

    @classmethod
    def by(cls, acting: Mapping[int, Nuisance]) -> "_Differences":
        """Return the differences by nuisances, given by their indices."""
        ordered = sorted(acting.items(), key=lambda item: _way(item[1]))
        nuisances = [n for _, n in ordered]
        return cls(
            np.array([i for i, _ in ordered]),
            sum(_way(n) is _Way.SIMULATED for n in nuisances),
            np.array([_step(n) for n in nuisances]),
            np.array([n.name not in _STEPS for n in nuisances]),
        )

    def lengths(self, nuisances: FloatArray) -> FloatArray:
        """Return the steps (e,) from a point (q,), with their signs."""
        inwards = self.inwards & (nuisances[self.lanes] > 0.0)
        return np.where(inwards, -self.steps, self.steps)


class MotionModel:
    """Motion of a vehicle on a drive, by parameters and nuisances.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle in which the parameters to identify are the only unknown ones.
    drive : MeasuredDrive
        Commands and signals.
    effects : sequence of Effect
        Estimated beside the parameters.
    simulator : callable
        Makes of vehicle, commands and speed before them what simulates samples of the vehicle.
    measured : collection of Input
        Inputs that move as measured, where the drive tells them.

    Attributes
    ----------
    drive : MeasuredDrive
        Drive with the signals that are compared: not those of sensors that the simulator lacks, nor
        the speed of wheels that move as measured.
    measured : frozenset of Input
        Inputs that move as measured on this drive.
    time : ndarray of float, shape (t,)
        Ticks, since the start event [s].
    nuisances : tuple of Nuisance
        Nuisances that the motion depends on; those that all drives have in common come first.
    lanes : ndarray of int, shape (e,)
        Indices of the nuisances by which the motion is differentiated.
    low, width : ndarray of float, shape (k,)
        Lower ends and widths of the parameters' ranges, in the parameters' units.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        drive: MeasuredDrive,
        effects: Sequence[Effect],
        simulator: Simulator,
        measured: Collection[Input],
    ) -> None:
        can_follow = frozenset(Input) if has_gains(vehicle) else {Input.STEERING}
        self.measured = drive.measured_throughout & can_follow & frozenset(measured)
        if Input.SPEED in self.measured:
            vehicle = with_stiff_loop(vehicle)
        self._vehicle, self._effects = vehicle, effects
        self.low, high = np.array(list(vehicle.unknown.values())).T
        self.width = high - self.low
        self._followed = _follow(vehicle, drive, self.measured)
        self._affected = with_effects(vehicle, effects)
        self._batch = simulator(self._affected, drive.commands, setpoint=drive.start.speed)
        self._without_effects = (
            simulator(vehicle, drive.commands, setpoint=drive.start.speed)
            if effects
            else self._batch
        )
        self.time = self._batch.time
        self.drive, self._columns = _compared(drive, self._batch.available, self.measured)
        self.nuisances = (
            *chain.from_iterable(map(self._of_effect, sorted(effects, key=lambda e: e.per_drive))),
            Nuisance(START_SPEED, "m/s", drive.start.speed, START_SPEED_STD),
            *self._of_inputs(drive),
            *self._of_path(),
            *self._of_poses(drive),
        )
        self._in_units = InUnits(self.nuisances)
        idle = {name for one in self.measured for name in OF_INPUT[one]}
        acting = {
            i: n
            for i, n in enumerate(self.nuisances)
            if n.effect is None or n.effect.name not in idle
        }
        self._differences = _Differences.by(acting)
        self.lanes = self._differences.lanes
        self._at = {n.name: i for i, n in acting.items()}
        self._places = {
            name: np.array(
                [i for n, i in self._at.items() if n.rpartition(" ")[0] == name], dtype=np.int64
            )
            for name in (START_DEVIATION, *_SPACING)
        }

    def parameters(self, z: FloatArray) -> FloatArray:
        """Return parameters in their units.

        Parameters
        ----------
        z : ndarray of float, shape (..., k)
            In their ranges.
        """
        values: FloatArray = self.low + self.width * z
        return values

    def unaffected(self, Z: FloatArray) -> Motions:
        """Return the motions of n vehicles without effects, from the measured speed.

        Parameters
        ----------
        Z : ndarray of float, shape (n, k)
            Parameters in their ranges.
        """
        means = np.tile(self._in_units.means, (len(Z), 1))
        return self._run(self._without_effects, self.parameters(Z), means)

    def friction_used(self, z: FloatArray) -> float:
        """Return the largest share of its friction limit that a wheel uses; NaN: not known.

        Parameters
        ----------
        z : ndarray of float, shape (k,)
            Parameters in their ranges.
        """
        speed = np.array([self.drive.start.speed])
        run = self._without_effects.run(self.parameters(z)[np.newaxis], ("x",), speed=speed)
        return float(run.feasibility.friction.value[0]) if run.groups.size else math.nan

    def motion(self, z: FloatArray, nuisances: FloatArray) -> Motions:
        """Return the motion at a point, as n = 1.

        Parameters
        ----------
        z : ndarray of float, shape (k,)
            Parameters in their ranges.
        nuisances : ndarray of float, shape (q,)
            Deviations from the means of their priors, in standard deviations.
        """
        return self._lanes_of(z[np.newaxis], nuisances[np.newaxis])

    def steps(self, z: FloatArray, nuisances: FloatArray) -> tuple[Motions, FloatArray]:
        """Return the motion at a point and one step of each variable from it, with the steps.

        Parameters
        ----------
        z : ndarray of float, shape (k,)
            Parameters in their ranges.
        nuisances : ndarray of float, shape (q,)
            Deviations from the means of their priors, in standard deviations.

        Returns
        -------
        motions : Motions
            Motions of 1 + k + e vehicles: at the point, after a step of each parameter, and after a
            step of each nuisance of `lanes`.
        lengths : ndarray of float, shape (k + e,)
            Lengths of the steps: of parameters in their ranges, of nuisances in standard deviations
            of their priors.
        """
        k, e = len(z), len(self.lanes)
        lengths = np.append(np.where(z < 0.5, STEP, -STEP), self._differences.lengths(nuisances))
        Z, all_nuisances = np.tile(z, (1 + k + e, 1)), np.tile(nuisances, (1 + k + e, 1))
        Z[1 + np.arange(k), np.arange(k)] += lengths[:k]
        all_nuisances[1 + k + np.arange(e), self.lanes] += lengths[k:]
        return self._lanes_of(Z, all_nuisances), lengths

    def knots_of(self, name: str) -> NDArray[np.int64]:
        """Return the indices of a deviation's or error's knots, evenly spaced to the end.

        Parameters
        ----------
        name : str
            Name of the deviation or the error.
        """
        return self._places[name]

    def _lanes_of(self, Z: FloatArray, nuisances: FloatArray) -> Motions:
        """Motions of n lanes; those after the simulated ones have the parameters of the first."""
        values = self._in_units(nuisances)
        simulated = min(len(Z), 1 + len(self.low) + self._differences.simulated)
        constants = affected_constants(
            self._affected,
            self._vehicle.unknown,
            self.parameters(Z[:simulated]),
            self._effects,
            {name: values[:simulated, i] for name, i in self._at.items()},
        )
        motion = self._run(self._batch, constants, values[:simulated])
        if DRIVE_DEAD_TIME in self._at and len(Z) > simulated:
            later = values[simulated : simulated + 1]
            motion = motion.with_another(self._run(self._batch, constants[:1], later))
        return self._distorted(motion, values)

    def _run(self, batch: Batch, constants: FloatArray, values: FloatArray) -> Motions:
        """Motions of vehicles with values (n, K) of the batch's unknown, and nuisances (n, q).

        The drive has the dead time of the first vehicle in all.
        """
        of = {name: values[:, i] for name, i in self._at.items()}
        faster, steered = None, None
        if len(starting := self.knots_of(START_DEVIATION)):
            faster = _at_start(values[:, starting], self.time)
        if (speed := self._followed.get(Input.SPEED)) is not None:
            added = speed.added(of[SPEED_DELAY], of[SPEED_ZERO], np.zeros(len(values)))
            faster = added if faster is None else faster + added
        if (steering := self._followed.get(Input.STEERING)) is not None:
            steered = steering.added(of[STEERING_DELAY], of[STEERING_ZERO], of[STEERING_GAIN])
        if len(self.knots_of(TURN_ERROR)):
            added = _between(self._at_knots(TURN_ERROR, values), len(self.time))
            steered = added if steered is None else steered + added
        names = ["x", "y", "yaw", "yaw_rate", "drive_speed"]
        own_speed = () if self.drive.speed is None else ("vx",)
        run = batch.run(
            constants,
            [*names, *own_speed, *chain.from_iterable(self._columns.values())],
            speed=of[START_SPEED],
            steering_delay=of.get(SERVO_DEAD_TIME),
            drive_delay=float(of[DRIVE_DEAD_TIME][0]) if DRIVE_DEAD_TIME in of else 0.0,
            faster=faster,
            steered=steered,
        )
        seen = {s: np.array([run.columns[n] for n in own]) for s, own in self._columns.items()}
        motion = Motions(*(run.columns[name] for name in names), others=seen)
        if self.drive.speed is None:
            return motion
        return self._at_speed(motion, run.columns["vx"], self.drive.speed)

    def _at_speed(self, motion: Motions, own: FloatArray, wanted: FloatArray) -> Motions:
        """Motions at a speed (t,), along the paths of those at their own speeds (n, t).

        The speeds differ by what resists each vehicle, that is little: its tyres are taken to
        answer alike.
        """
        moves = np.abs(own) > RESTING
        faster = np.where(moves, wanted / np.where(moves, own, 1.0), 1.0) - 1.0
        return self._deviated(motion, faster, np.zeros_like(faster))

    def _distorted(self, motion: Motions, values: FloatArray) -> Motions:
        """Motions (n, t) with what is no constant of the vehicle, by nuisances (n, q).

        There may be more values than motions: the others are of the first motion.
        """
        deviations = SPEED_DEVIATION, TURN_DEVIATION
        if len(self.knots_of(SPEED_ERROR)) and self.drive.speed is not None:
            faster = self._at_knots(SPEED_ERROR, values)  # m/s, as a share of it
            at = np.linspace(0, len(self.drive.speed) - 1, faster.shape[1]).astype(int)
            speed = self.drive.speed[at]
            faster *= np.where(np.abs(speed) > RESTING, 1.0 / np.where(speed, speed, 1.0), 0.0)
            motion = self._deviated(motion, faster, np.zeros_like(faster))
        if any(len(self.knots_of(name)) for name in deviations):
            motion = self._deviated(motion, *(self._at_knots(name, values) for name in deviations))
        elif len(values) > len(motion.x):
            motion = motion.of(_lanes(len(motion.x), len(values)))
        named = {name: values[:, i] for name, i in self._at.items()}
        x, y, heading = as_sensed(motion.x, motion.y, motion.heading, named)
        if POSE_FILTER in named:
            x, y, heading = low_passed(np.array([x, y, heading]), named[POSE_FILTER])
        return dataclasses.replace(motion, x=x, y=y, heading=heading)

    def _deviated(self, motion: Motions, faster: FloatArray, turning: FloatArray) -> Motions:
        """Motions that deviate at knots (n, j) from those given, or from the first one.

        Of the other sensors: wheels roll as the body moves, the acceleration changes with speed
        times yaw rate, and the torque stays.
        """
        found = Motions(*deviated(np.array(motion.rows), faster, turning))
        before = motion.of(_lanes(len(motion.x), len(faster)))
        others, radius = before.others, self._vehicle.driven_radius
        speeds = tuple(radius * one.wheel_speed for one in (before, found))
        if (rows := others.get(Sensor.LATERAL_ACCELERATION)) is not None:
            rows += speeds[1] * found.yaw_rate - speeds[0] * before.yaw_rate
        if (rows := others.get(Sensor.WHEEL_SPEEDS)) is not None:
            more, turned = speeds[1] - speeds[0], found.yaw_rate - before.yaw_rate
            wheels = {wheel.name: wheel for wheel in self._vehicle.wheels}
            for row, name in zip(rows, self.drive.signals[Sensor.WHEEL_SPEEDS].wheels, strict=True):
                place = self._vehicle.of(wheels[name])
                row += (more - place.y * turned) / place.tyre_radius
        return dataclasses.replace(found, others=others)

    def _at_knots(self, name: str, values: FloatArray) -> FloatArray:
        """A deviation or error at all its knots (n, j), by nuisances (n, q); the first may be 0."""
        own = np.take(values, self.knots_of(name), axis=1)
        return np.pad(own, ((0, 0), (self._knots(_SPACING[name]) - own.shape[1], 0)))

    def _knots(self, apart: float) -> int:
        """Number of knots so many s apart, from start to end."""
        return max(2, round(float(self.time[-1]) / apart)) + 1

    def _of_effect(self, effect: Effect) -> list[Nuisance]:
        """An effect, or the values of a deviation at its knots."""
        names, low = [effect.name], lowest(effect, self.drive.steering_late)
        if effect.name == START_DEVIATION:  # of a vehicle that stands, and has a speed loop
            stands = abs(self.drive.start.speed) < RESTING
            knots = len(START) - 2 if stands and self._vehicle.has_speed_loop else 0
            names = [f"{effect.name} {number}" for number in range(knots)]
        elif effect.process:
            knots = self._knots(_SPACING[effect.name])
            names = [f"{effect.name} {number}" for number in range(knots)]
        return [Nuisance(n, effect.unit, 0.0, effect.std, low, effect.high, effect) for n in names]

    def _of_inputs(self, drive: MeasuredDrive) -> Iterator[Nuisance]:
        """Errors of the inputs that move as measured.

        A steady value is off by up to half a step of its sensor, another angle by another share.
        """
        if Input.STEERING in self._followed and drive.steering_angle is not None:
            off = max(0.5 * resolution(drive.steering_angle.values), LEAST_OFF)
            largest = float(np.abs(self._followed[Input.STEERING].following).max())
            yield Nuisance(STEERING_DELAY, "s", 0.0, INPUT_DELAY_STD)
            yield Nuisance(STEERING_ZERO, "rad", 0.0, off)
            yield Nuisance(STEERING_GAIN, "1", 0.0, off / max(largest, off))
        if Input.SPEED in self._followed:
            step = resolution(drive.signals[Sensor.WHEEL_SPEED].values[:, 0])
            off = max(0.5 * self._vehicle.driven_radius * step, LEAST_SPEED_OFF)
            yield Nuisance(SPEED_DELAY, "s", 0.0, INPUT_DELAY_STD)
            yield Nuisance(SPEED_ZERO, "m/s", 0.0, off)

    def _of_poses(self, drive: MeasuredDrive) -> Iterator[Nuisance]:
        """Time constant of the filter that poses come out of, as far as they are filtered."""
        if drive.pose_filter > 0.0:
            yield Nuisance(POSE_FILTER, "s", drive.pose_filter, POSE_FILTER_STD, low=0.0)

    def _of_path(self) -> Iterator[Nuisance]:
        """Errors of a speed and a steering that are followed, from the first sample on."""
        first = min(float(signal.time[0]) for signal in self.drive.signals.values())
        first = max(first, 0.0)  # a drive of its own may have been measured before its start
        angle_std = self.drive.turn_std / abs(curvature_per_angle(self._vehicle))
        for name, unit, std in (
            (SPEED_ERROR, "m/s", 0.0 if self.drive.speed is None else self.drive.speed_std),
            (TURN_ERROR, "rad", angle_std),
        ):
            knots, begin = self._knots(_SPACING[name]), max(first - BEFORE[name], 0.0)
            before = int(begin / float(self.time[-1]) * (knots - 1))
            for number in range(knots - before if std > 0.0 else 0):
                yield Nuisance(f"{name} {number}", unit, 0.0, std)


def _compared(
    drive: MeasuredDrive, available: Collection[str], measured: Collection[Input]
) -> tuple[MeasuredDrive, dict[Sensor, tuple[str, ...]]]:
    """The drive with the signals that are compared, and the columns that sensors of them see.

    Columns are those of the simulator's `available` ones that sensors see which not every drive
    has. The speed of wheels that move as measured is not compared.
    """
    seen = _OF_SOME_DRIVES | _wheel_columns(drive)
    columns = {
        sensor: own
        for sensor, own in seen.items()
        if sensor in drive.signals and set(own) <= set(available)
    }
    left_out = seen.keys() - columns.keys()
    if Input.SPEED in measured:
        left_out |= {Sensor.WHEEL_SPEED}
    signals = {s: signal for s, signal in drive.signals.items() if s not in left_out}
    return dataclasses.replace(drive, signals=signals), columns


def lowest(effect: Effect, steering_late: float) -> float:
    """Return the least value of an effect in drives whose steering may have been logged late.

    Parameters
    ----------
    effect : Effect
        The effect.
    steering_late : float
        As of `MeasuredDrive` [s].
    """
    return effect.low - (steering_late if effect.name == SERVO_DEAD_TIME else 0.0)


def _follow(
    vehicle: Vehicle, drive: MeasuredDrive, inputs: Collection[Input]
) -> dict[Input, _Followed]:
    """Inputs that move as measured."""
    found = {}
    if Input.STEERING in inputs and drive.steering_angle is not None:
        of = setpoints_for_steering(drive.commands, drive.steering_angle, vehicle)
        found[Input.STEERING] = _Followed(*of, np.ones(len(of[1]), dtype=bool))
    if Input.SPEED in inputs:
        wheels = drive.signals[Sensor.WHEEL_SPEED]
        of = setpoints_for_speed(drive.commands, wheels, vehicle, drive.start.speed)
        found[Input.SPEED] = _Followed(*of, np.abs(of[1]) > RESTING)
    return found


def _way(nuisance: Nuisance) -> _Way:
    """Way to find the motion with a step of a nuisance."""
    if nuisance.effect is None:  # the steering moves the body by way of its tyres
        simulated = nuisance.name in _STEPS or nuisance.name.startswith(TURN_ERROR)
        return _Way.SIMULATED if simulated else _Way.DISTORTED
    if nuisance.effect.name == DRIVE_DEAD_TIME:
        return _Way.DELAYED
    simulated = nuisance.effect.name in (SERVO_DEAD_TIME, START_DEVIATION)
    return _Way.SIMULATED if simulated or nuisance.effect.constants else _Way.DISTORTED


def _step(nuisance: Nuisance) -> float:
    """Step of the finite difference by a nuisance, in standard deviations."""
    if nuisance.effect is not None:
        return nuisance.effect.step
    if nuisance.name in _STEPS:
        return _STEPS[nuisance.name] / nuisance.std
    return ERROR_STEP


def _wheel_columns(drive: MeasuredDrive) -> dict[Sensor, tuple[str, ...]]:
    """Columns of the simulation that the sensors of single wheels see."""
    if (speeds := drive.signals.get(Sensor.WHEEL_SPEEDS)) is None:
        return {}
    return {Sensor.WHEEL_SPEEDS: tuple(f"wheel_speed_{wheel}" for wheel in speeds.wheels)}


def _lanes(motions: int, lanes: int) -> NDArray[np.int64]:
    """Index of the motion in each lane; lanes beyond the number of motions repeat the first."""
    return np.where(np.arange(lanes) < motions, np.arange(lanes), 0)


def _between(knots: FloatArray, ticks: int) -> FloatArray:
    """Rows (n, ticks) that are linear between evenly spaced knots (n, j)."""
    place = np.linspace(0.0, knots.shape[1] - 1.0, ticks)
    before = np.minimum(place.astype(int), knots.shape[1] - 2)
    weight = place - before
    rows: FloatArray = (1.0 - weight) * knots[:, before] + weight * knots[:, before + 1]
    return rows


def _at_start(knots: FloatArray, time: FloatArray) -> FloatArray:
    """Deviation of a start [m/s] at times (t,), (n, t), by its inner knots (n, j)."""
    faster = np.zeros((len(knots), len(time)))
    early = time < START[-1]
    for row, inner in zip(faster, knots, strict=True):
        row[early] = np.interp(time[early], START, [0.0, *inner, 0.0])
    return faster
