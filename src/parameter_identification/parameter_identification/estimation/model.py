"""Model of a drive: its signals, with their derivatives by parameters and nuisances.

One batch of the simulator gives the motion and its finite differences: the vehicle of the moment,
one per parameter, one per effect on the vehicle, one for the start speed; eight lanes cost what one
does. The drive's dead time, common to a batch, takes another one. The other effects change this
motion afterwards (`_distorted`), and are differentiated by doing so once more. The other nuisances
act in closed form: start pose (a rigid motion), time offsets of the clocks (a derivative by time),
errors of the sensors (linear in what they see).

All variables are scaled to be of the order 1: parameters in their ranges (0 to 1), a nuisance in
the standard deviation of its prior. Letters of shapes: `k` parameters, `q` nuisances of
the drive, `m` samples, `t` ticks.
"""

import dataclasses
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from excitation_planner.design.noise import DELAY_STD
from parameter_identification.drives.following import (
    has_gains,
    measured_speed,
    measured_steering,
    with_stiff_loop,
)
from parameter_identification.drives.measured import (
    Input,
    MeasuredDrive,
    Sensor,
    Signal,
    StartPose,
)
from parameter_identification.estimation.deviations import deviated
from parameter_identification.estimation.instruments import CLOCKS, errors_of
from parameter_identification.estimation.motions import Batch, Motions, Simulator
from parameter_identification.estimation.whiteness import resolution
from tricycle_core.errors import IdentificationError
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
    as_sensed,
    with_effects,
)
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.batch import CommandedBatch

STEP = 1e-4  # of the finite differences by parameters, in ranges
SPEED_STEP = 1e-3  # m/s
NEAR = 0.01, 0.05  # changes of parameters, nuisances that hardly change the derivatives
KNOTS = 1.0  # s between the values of a deviation, linear between them
FOLLOWED = 0.25  # s, the same of the error of a speed that is followed
ERROR_STEP = 0.01  # standard deviations, of its finite differences
RESTING = 0.05  # m/s, below which a drive starts from rest, and has no path to be followed
OF_INPUT = {Input.STEERING: OF_SERVO, Input.SPEED: OF_SPEED_LOOP}
"""Names of the effects of how each input comes about: without effect where it is measured."""

START = np.array([0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0, 4.0])
"""Knots of the deviation of a start from rest [s]: boards and motor are known least at low speed.

It vanishes at the first and at the last.
"""

# Standard deviations of the nuisances' priors
START_SPEED = 0.02  # m/s: the vehicle should stand still, or its speed was measured
INPUT_OFFSET = 0.01  # s, of a measured input's: mostly one computer stamps both
LEAST_OFF, LEAST_SPEED_OFF = 5e-4, 2e-4  # rad, of a measured steering angle; m/s
STEERING_DELAY, STEERING_ZERO, STEERING_GAIN = (
    f"{what} of the measured steering" for what in ("delay", "zero", "gain")
)
SPEED_DELAY, SPEED_ZERO = (f"{what} of the measured speed" for what in ("delay", "zero"))
SPEED_ERROR, TURN_ERROR = "error of the followed speed", "error of the followed steering"
INPUT_STEPS = {
    STEERING_DELAY: 1e-3,
    STEERING_ZERO: 1e-4,
    STEERING_GAIN: 1e-3,
    SPEED_DELAY: 1e-3,
    SPEED_ZERO: 1e-4,
}
"""Of the finite differences, in the nuisances' units."""


@dataclass(frozen=True)
class Nuisance:
    """An unknown of one drive that is no vehicle parameter, with its Gaussian prior.

    Attributes
    ----------
    name : str
        E.g. "start heading".
    unit : str
        Of mean and standard deviation.
    mean, std : float
        Of the prior.
    low, high : float
        Values between which it lies.
    effect : Effect, optional
        That it is of.
    """

    name: str
    unit: str
    mean: float
    std: float
    low: float = -math.inf
    high: float = math.inf
    effect: Effect | None = None


@dataclass(frozen=True, eq=False)
class Prediction:
    """A signal of a drive against the model.

    Attributes
    ----------
    sensor : Sensor
        That is predicted.
    time : ndarray of float, shape (m,)
        Of the samples [s].
    values : ndarray of float, shape (m, c)
        Predicted.
    residual : ndarray of float, shape (m, c)
        Measured less predicted.
    jacobian : ndarray of float, shape (m, c, k + q)
        Of the residual by all variables.
    channels : tuple of str
        Names of the columns.
    """

    sensor: Sensor
    time: FloatArray
    values: FloatArray
    residual: FloatArray
    jacobian: FloatArray
    channels: tuple[str, ...]


class DriveModel:
    """The model of one measured drive.

    Parameters
    ----------
    vehicle : Vehicle
        With the parameters to identify as its only unknown ones.
    drive : MeasuredDrive
        Commands and signals.
    effects : sequence of Effect, optional
        Estimated beside the parameters.
    simulator : callable
        Makes of vehicle, commands and speed before them what simulates samples of the vehicle.
    measured : collection of Input
        What moves as measured, where the drive tells it, instead of as commanded. A wheel that does
        so is no sensor any more, and `OF_INPUT` has no effect.

    Attributes
    ----------
    measured : frozenset of Input
        What does so here.
    shared : int
        Number of nuisances, the first ones, that all drives have in common.
    nuisances : tuple of Nuisance
        All of them.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        drive: MeasuredDrive,
        effects: Sequence[Effect] = (),
        simulator: Simulator = CommandedBatch,
        *,
        measured: Collection[Input] = (),
    ) -> None:
        can_follow = frozenset(Input) if has_gains(vehicle) else {Input.STEERING}
        self.simulator, self.measured = simulator, drive.told & can_follow & frozenset(measured)
        self.vehicle, self.effects = vehicle, tuple(effects)
        self.low, high = np.array(list(vehicle.unknown.values())).T
        self.width = high - self.low
        self._speed: tuple[FloatArray, FloatArray] | None = None
        self._speed_step = 0.0
        if Input.SPEED in self.measured:
            signals = dict(drive.signals)
            wheels, vehicle = signals.pop(Sensor.WHEEL_SPEED), with_stiff_loop(vehicle)
            self._speed = measured_speed(drive.commands, wheels, vehicle, drive.start.speed)
            self._speed_step = vehicle.driven_radius * resolution(wheels.values[:, 0])
            drive = dataclasses.replace(drive, signals=signals)
        simulated = with_effects(vehicle, effects)
        self._batch = simulator(simulated, drive.commands, setpoint=drive.start.speed)
        self._columns = _columns_of(drive)
        simulates = self._batch.available
        missing = [s for s, names in self._columns.items() if not set(names) <= set(simulates)]
        self._columns = {s: names for s, names in self._columns.items() if s not in missing}
        signals = {s: signal for s, signal in drive.signals.items() if s not in missing}
        self.drive = dataclasses.replace(drive, signals=signals)
        self._errors = {sensor: errors_of(sensor, signal) for sensor, signal in signals.items()}
        # the starts are chosen without effects
        self._unaffected = (
            simulator(vehicle, drive.commands, setpoint=drive.start.speed)
            if effects
            else self._batch
        )
        self._nominal = simulated.nominal_point()
        self._place = {name: i for i, name in enumerate(simulated.unknown)}
        self._parameters = [self._place[name] for name in vehicle.unknown]
        self.nuisances = self._effects(effects)
        self.shared = sum(not e.per_drive for e in effects)
        self._steering: tuple[FloatArray, FloatArray] | None = None
        if Input.STEERING in self.measured and drive.steering_angle is not None:
            self._steering = measured_steering(drive.commands, drive.steering_angle, vehicle)
        self.nuisances += self._start_and_sensors()
        self.nuisances += self._input_errors()
        self._at = {nuisance.name: i for i, nuisance in enumerate(self.nuisances)}
        self._input_errors_at = [
            [i for i, n in enumerate(self.nuisances) if n.name.startswith(f"{name} ")]
            for name in (SPEED_ERROR, TURN_ERROR)
        ]
        # by a simulation each: effects on constants, the start speed, dead times; by a distortion:
        # the rest
        effect_of = enumerate(n.effect for n in self.nuisances)
        idle = {name for one in self.measured for name in OF_INPUT[one]}
        effect_at = [(i, e) for i, e in effect_of if e is not None and e.name not in idle]
        acting = {e.name: i for i, e in effect_at}
        self._servo_delay = acting.get(SERVO_DEAD_TIME)
        self._drive_delay = acting.get(DRIVE_DEAD_TIME)
        self._starting = [i for i, e in effect_at if e.name == START_DEVIATION]
        simulated_too = (self._servo_delay, *self._starting)
        self._by_simulation = {i: e for i, e in effect_at if e.constants or i in simulated_too}
        # all that the motion and when it is seen depend on, beside the parameters
        still = {"start x", "start y", "start heading"}
        still |= {error.name for errors in self._errors.values() for error in errors}
        self._moving = [i for i, n in enumerate(self.nuisances) if n.name not in still]
        # the last ones by sensor, and the point (z, moving nuisances) that they are of
        self._derivatives: tuple[tuple[FloatArray, ...], dict[Sensor, FloatArray]] = (), {}
        delay = [] if self._drive_delay is None else [self._drive_delay]
        others = (i for i, _ in effect_at if i not in (*self._by_simulation, *delay))
        self._stepped = [*self._by_simulation, *delay, *others, *chain(*self._input_errors_at)]
        # by a simulation each, without being an effect; with its step
        self._varied = {self._at["start speed"]: SPEED_STEP}
        for name, step in INPUT_STEPS.items():
            if name in self._at:
                self._varied[self._at[name]] = step
        effects_stepped = (self.nuisances[i].effect for i in self._stepped)
        self._effect_steps = np.array([e.step if e else ERROR_STEP for e in effects_stepped])

    def _effects(self, effects: Sequence[Effect]) -> tuple[Nuisance, ...]:
        """Nuisances of effects, those that all drives share first."""
        found = []
        for e in sorted(effects, key=lambda e: e.per_drive):
            names, low = [e.name], e.low
            if e.name == SERVO_DEAD_TIME:
                low -= self.drive.steering_late
            if e.process:
                names = [f"{e.name} {number}" for number in range(self._knots_of(e.name))]
            found += [Nuisance(name, e.unit, 0.0, e.std, low, e.high, e) for name in names]
        return tuple(found)

    def _input_errors(self) -> tuple[Nuisance, ...]:
        """Nuisances of a speed and a steering that are followed, at knots from the first sample."""
        if self.drive.speed is None:
            return ()
        knots = self._knots(FOLLOWED)
        first = min(float(signal.time[0]) for signal in self.drive.signals.values())
        before = int(first / float(self._batch.time[-1]) * (knots - 1))
        return tuple(
            Nuisance(f"{name} {number}", unit, 0.0, std)
            for name, unit, std in (
                (SPEED_ERROR, "m/s", self.drive.speed_std),
                (TURN_ERROR, "1/m", self.drive.turn_std),
            )
            for number in range(knots - before)
            if std > 0.0
        )

    def _start_and_sensors(self) -> tuple[Nuisance, ...]:
        x, y, heading = self._start_guess()
        start = self.drive.start
        found = [
            Nuisance("start x", "m", x, start.position_std),
            Nuisance("start y", "m", y, start.position_std),
            Nuisance("start heading", "rad", heading, start.heading_std),
            Nuisance("start speed", "m/s", start.speed, START_SPEED),
        ]
        if self._steering is not None and self.drive.steering_angle is not None:
            # a steady angle is off by up to half a step of its sensor, another one by another share
            _, measured = self._steering
            off = max(0.5 * resolution(self.drive.steering_angle.values), LEAST_OFF)
            share = off / max(float(np.abs(measured).max()), off)
            found += [
                Nuisance(STEERING_DELAY, "s", 0.0, INPUT_OFFSET),
                Nuisance(STEERING_ZERO, "rad", 0.0, off),
                Nuisance(STEERING_GAIN, "1", 0.0, share),
            ]
        if self._speed is not None:
            # a steady speed is off by up to half a step of its sensor
            off = max(0.5 * self._speed_step, LEAST_SPEED_OFF)
            found += [
                Nuisance(SPEED_DELAY, "s", 0.0, INPUT_OFFSET),
                Nuisance(SPEED_ZERO, "m/s", 0.0, off),
            ]
        clocks = dict.fromkeys(CLOCKS[sensor] for sensor in self.drive.signals)
        found += [Nuisance(clock, "s", 0.0, DELAY_STD) for clock in clocks]
        for errors in self._errors.values():
            found += [Nuisance(error.name, error.unit, 0.0, error.std) for error in errors]
        return tuple(found)

    def _start_guess(self) -> tuple[float, float, float]:
        """Start pose if known, else from the first second, or of the best rigid motion."""
        start: StartPose = self.drive.start
        motion = self._motion(self._unaffected, self.vehicle.nominal_point()[np.newaxis])
        position = self.drive.signals[Sensor.POSITION]
        early = position.time <= position.time[0] + max(5.0, 0.5 * float(np.ptp(position.time)))
        time = position.time[early]
        ticks = self._batch.time
        model = np.interp(time, ticks, motion.x[0]) + 1j * np.interp(time, ticks, motion.y[0])
        measured = position.values[early] @ np.array([1.0, 1j])
        heading_signal = self.drive.signals.get(Sensor.HEADING)
        if start.heading is not None:
            heading = start.heading
        elif heading_signal is not None:
            predicted = np.interp(heading_signal.time, ticks, motion.heading[0])
            first = heading_signal.time <= max(0.5, float(heading_signal.time[0]) + 0.1)
            heading = float(np.mean((heading_signal.values[:, 0] - predicted)[first]))
        else:  # Umeyama, IEEE PAMI 13, 1991, in the plane
            heading = float(np.angle(np.vdot(model - model.mean(), measured - measured.mean())))
        at_rest = np.abs(model) < 0.02  # m from the start
        rest = (measured - model * np.exp(1j * heading))[at_rest if at_rest.any() else ...]
        origin = np.mean(rest)
        x = float(origin.real) if start.x is None else start.x
        y = float(origin.imag) if start.y is None else start.y
        return x, y, heading

    def parameters(self, z: FloatArray) -> FloatArray:
        """Return parameters (..., k) in their units for those in ranges."""
        values: FloatArray = self.low + self.width * z
        return values

    def _in_units(self, nuisances: FloatArray) -> FloatArray:
        """Nuisances (q,) in their units, of those in standard deviations from their means."""
        pairs = zip(self.nuisances, nuisances, strict=True)
        return np.array([n.mean + n.std * v for n, v in pairs])

    def _motion(
        self, batch: Batch, constants: FloatArray, nuisances: FloatArray | None = None
    ) -> Motions:
        """Motions of vehicles with values (n, K) of the batch's unknown, and nuisances (n, q).

        By default the start speed is the measured one, and there is no dead time. The drive has the
        dead time of the first vehicle in all.
        """
        speeds, steering, drive = np.full(len(constants), self.drive.start.speed), None, 0.0
        faster, steered = None, None
        if nuisances is not None:
            speeds = nuisances[:, self._at["start speed"]]
            if self._servo_delay is not None:
                steering = nuisances[:, self._servo_delay]
            if self._drive_delay is not None:
                drive = float(nuisances[0, self._drive_delay])
            if self._steering is not None:
                steered = self._steered(nuisances, *self._steering)
            if self._starting:
                faster = _at_start(nuisances[:, self._starting], batch.time)
        if self._speed is not None:
            later, more = np.zeros((2, len(constants)))
            if nuisances is not None:
                later, more = nuisances[:, [self._at[SPEED_DELAY], self._at[SPEED_ZERO]]].T
            faster = _sped(later, more, *self._speed) + (0.0 if faster is None else faster)
        names = ["x", "y", "yaw", "yaw_rate", "drive_speed"]
        others = [name for columns in self._columns.values() for name in columns]
        if self.drive.speed is not None:
            names.append("vx")
        run = batch.run(
            *(constants, names + others),
            speed=speeds,
            steering_delay=steering,
            drive_delay=drive,
            faster=faster,
            steered=steered,
        )
        seen = {s: np.array([run.columns[n] for n in own]) for s, own in self._columns.items()}
        motion = Motions(*(run.columns[name] for name in names[:5]), others=seen)
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
        motions = deviated(np.array(motion.rows), faster, np.zeros_like(faster))
        return Motions(*motions, others=self._others_of(motion, motions))

    def _steered(
        self, nuisances: FloatArray, setpoints: FloatArray, measured: FloatArray
    ) -> FloatArray:
        """Angles (n, t) by which set-points (t,) are others, by nuisances (n, q)."""
        ticks = TICK * np.arange(len(setpoints))
        at = [self._at[name] for name in (STEERING_DELAY, STEERING_ZERO, STEERING_GAIN)]
        rows = [
            np.interp(ticks + delay, ticks, measured) * (1.0 + gain) + zero - setpoints
            for delay, zero, gain in nuisances[:, at]
        ]
        return np.pad(rows, ((0, 0), (0, 1)), mode="edge")

    def predict(self, z: FloatArray, nuisances: FloatArray) -> list[Prediction]:
        """Predict all signals.

        Derivatives of the motion are those of a point nearby (`NEAR`) if there is one: at the end
        of a search, where steps are small, one vehicle is simulated instead of dozens.

        Parameters
        ----------
        z : ndarray of float, shape (k,)
            Parameters in their ranges.
        nuisances : ndarray of float, shape (q,)
            Deviations from the means of their priors, in standard deviations.
        """
        b = self._in_units(nuisances)
        point, kept = self._derivatives
        here = z, nuisances[self._moving]
        near = bool(kept) and all(
            np.all(np.abs(now - then) <= limit)
            for now, then, limit in zip(here, point, NEAR, strict=True)
        )
        motion, differences = self._stepped_motions(z, nuisances, b, steps=not near)
        found = {}
        for sensor, signal in self.drive.signals.items():
            delay = b[self._at[CLOCKS[sensor]]]
            columns, slopes = motion.sensed(sensor, signal.time - delay)  # (c, m, lanes), (c, m)
            derivatives = (columns[..., 1:] - columns[..., :1]) / differences
            found[sensor] = columns[..., 0], slopes, derivatives
        if not near:
            kept = {sensor: derivatives for sensor, (_, _, derivatives) in found.items()}
            self._derivatives = (z.copy(), here[1]), kept
        return [
            self._assemble(sensor, self.drive.signals[sensor], values, slopes, kept[sensor], b)
            for sensor, (values, slopes, _) in found.items()
        ]

    def conditions(self, z: FloatArray, nuisances: FloatArray, time: FloatArray) -> FloatArray:
        """Return speed, steering set-point, lateral acceleration and heading (4, s) of the model.

        Parameters
        ----------
        z : ndarray of float, shape (k,)
            Parameters in their ranges.
        nuisances : ndarray of float, shape (q,)
            Deviations from the means of their priors, in standard deviations.
        time : ndarray of float, shape (s,)
            Since the start event [s]; the heading is in the frame of the positions.
        """
        b = self._in_units(nuisances)
        motion, _ = self._stepped_motions(z, nuisances, b, steps=False)
        rows = (motion.wheel_speed[0], motion.yaw_rate[0], motion.heading[0])
        rate, yaw_rate, heading = (np.interp(time, self._batch.time, row) for row in rows)
        speed = self.vehicle.driven_radius * rate
        commands = self.drive.commands
        held = np.searchsorted(commands.time, time + 1e-9, side="right") - 1
        steering = commands.steering_motor_angle[np.maximum(held, 0)]
        start = b[self._at["start heading"]]
        return np.array([speed, steering, speed * yaw_rate, heading + start])

    def knots_of(self, name: str) -> NDArray[np.int64]:
        """Return which nuisances are the knots of a deviation, evenly spaced from start to end.

        Parameters
        ----------
        name : str
            `SPEED_DEVIATION` or `TURN_DEVIATION`.
        """
        first = self._at.get(f"{name} 0")
        return np.arange(0) if first is None else np.arange(first, first + self._knots_of(name))

    def _stepped_motions(
        self, z: FloatArray, nuisances: FloatArray, b: FloatArray, *, steps: bool
    ) -> tuple[Motions, FloatArray]:
        """Motions (n, t) at a point and, with `steps`, one step of each variable from it.

        The variables are parameters, start speed and effects; returned with the lengths of the
        steps (n - 1,). Nuisances are given in standard deviations, and in their units as `b`.
        """
        k = len(z)
        if not steps:
            point = self._nominal[np.newaxis].copy()
            point[:, self._parameters] = self.parameters(z)
            self._apply_effects(point, b[np.newaxis])
            motion = self._motion(self._batch, point, b[np.newaxis])
            return self._distorted(motion, b[np.newaxis]), np.empty(0)
        lengths = np.where(z < 0.5, STEP, -STEP)
        # lanes: here, a step of each parameter, of the other variables, of each effect
        first = 1 + k + len(self._varied)
        ranges = np.repeat(z[np.newaxis], first + len(self._by_simulation), axis=0)
        ranges[np.arange(1, k + 1), np.arange(k)] += lengths
        stepped = self._stepped
        values = np.repeat(b[np.newaxis], first + len(stepped), axis=0)
        for lane, (i, step) in enumerate(self._varied.items(), start=1 + k):
            values[lane, i] += step
        effect_steps = self._effect_steps * np.where(nuisances[stepped] > 0.0, -1.0, 1.0)
        std = np.array([self.nuisances[i].std for i in stepped])
        values[np.arange(first, len(values)), stepped] += effect_steps * std
        points = np.tile(self._nominal, (len(ranges), 1))
        points[:, self._parameters] = self.parameters(ranges)
        self._apply_effects(points, values[: len(points)])
        motion = self._motion(self._batch, points, values[: len(points)])
        if self._drive_delay is not None:  # which all vehicles of a batch have in common
            later = values[len(points) : len(points) + 1]
            motion = motion.with_another(self._motion(self._batch, points[:1], later))
        motion = self._distorted(motion, values)
        varied = [step / self.nuisances[i].std for i, step in self._varied.items()]
        return motion, np.concatenate([lengths, varied, effect_steps])

    def _apply_effects(self, points: FloatArray, values: FloatArray) -> None:
        """Change the constants of vehicles (n, K) by the effects' values among those of (n, q)."""
        for i, effect in self._by_simulation.items():
            for constant, change in effect.constants.items():
                points[:, self._place[constant]] += change * values[:, i]

    def _distorted(self, motion: Motions, values: FloatArray) -> Motions:
        """Motions (n, t) with the effects that are no constants, by values (n, q).

        There may be more values than motions: the others are of the first motion.
        """
        motions, others = np.array(motion.rows), motion.others
        if self.drive.speed is not None and any(self._input_errors_at):
            knots = self._knots(FOLLOWED)
            faster, turning = (
                np.pad(values[:, own], ((0, 0), (knots - len(own), 0)))
                for own in self._input_errors_at
            )
            speed = self.drive.speed[np.linspace(0, len(self.drive.speed) - 1, knots).astype(int)]
            faster *= np.where(np.abs(speed) > RESTING, 1.0 / np.where(speed, speed, 1.0), 0.0)
            motions = deviated(motions, faster, turning)
        deviations = (SPEED_DEVIATION, TURN_DEVIATION)
        if any(f"{name} 0" in self._at for name in deviations):
            motions = deviated(motions, *(self._at_knots(name, values) for name in deviations))
        elif more := len(values) - motions.shape[1]:
            motions = np.concatenate([motions, np.repeat(motions[:, :1], more, axis=1)], axis=1)
        if others:
            others = self._others_of(motion, motions)
        x, y, heading, yaw_rate, wheel_speed = motions
        named = {name: values[:, i] for name, i in self._at.items()}
        x, y, heading = as_sensed(x, y, heading, named)
        return Motions(x, y, heading, yaw_rate, wheel_speed, others=others)

    def _others_of(self, motion: Motions, motions: FloatArray) -> dict[Sensor, FloatArray]:
        """What the other sensors see of motions (5, n, t) that deviate from those given.

        There may be more of them: those deviate from the first one given. Wheels roll as the body
        moves, the acceleration changes with speed times yaw rate, and the torque stays.
        """
        own = np.arange(motions.shape[1])
        own[len(motion.x) :] = 0
        others = {sensor: rows[:, own] for sensor, rows in motion.others.items()}
        radius = self.vehicle.driven_radius
        before = radius * motion.wheel_speed[own], motion.yaw_rate[own]
        after = radius * motions[4], motions[3]
        if (rows := others.get(Sensor.LATERAL_ACCELERATION)) is not None:
            rows += after[0] * after[1] - before[0] * before[1]
        if (rows := others.get(Sensor.WHEEL_SPEEDS)) is not None:
            faster, turning = (late - early for late, early in zip(after, before, strict=True))
            wheels = {wheel.name: wheel for wheel in self.vehicle.wheels}
            for row, name in zip(rows, self.drive.signals[Sensor.WHEEL_SPEEDS].wheels, strict=True):
                place = self.vehicle.of(wheels[name])
                row += (faster - place.y * turning) / place.tyre_radius
        return others

    def _knots_of(self, name: str) -> int:
        """Number of knots of a deviation.

        A vehicle that rolls already has no start to deviate, and one without a speed loop no
        set-point of the speed.
        """
        if name == START_DEVIATION:
            starts = self.vehicle.has_speed_loop and abs(self.drive.start.speed) < RESTING
            return len(START) - 2 if starts else 0
        return self._knots(KNOTS)

    def _knots(self, apart: float) -> int:
        """Number of knots so many s apart, from start to end."""
        return max(2, round(float(self._batch.time[-1]) / apart)) + 1

    def _at_knots(self, name: str, values: FloatArray) -> FloatArray:
        """Return a deviation at its knots (n, k) of values (n, q); zeros if there is none."""
        knots = self._knots_of(name)
        first = self._at.get(f"{name} 0")
        if first is None:
            return np.zeros((len(values), knots))
        return np.ascontiguousarray(values[:, first : first + knots])

    def _assemble(
        self,
        sensor: Sensor,
        signal: Signal,
        values: FloatArray,
        slopes: FloatArray,
        derivatives: FloatArray,
        b: FloatArray,
    ) -> Prediction:
        """Apply start pose, delay and the sensor's errors to a motion.

        Values and their slopes per second are (c, m), derivatives by the parameters, the start
        speed and the effects (c, m, k + 1 + e), the nuisances `b` (q,) in their units.
        """
        k = len(self.low)
        at = self._at
        x0, y0, psi0 = (b[at[name]] for name in ("start x", "start y", "start heading"))
        channels = signal.channels(sensor)
        jacobian = np.zeros((len(signal.time), len(channels), k + len(b)))
        if sensor is Sensor.POSITION:
            turn = np.array([[math.cos(psi0), -math.sin(psi0)], [math.sin(psi0), math.cos(psi0)]])
            values, slopes = turn @ values, turn @ slopes
            derivatives = np.einsum("ij,jmk->imk", turn, derivatives)
            jacobian[:, 0, k + at["start heading"]] = -values[1]
            jacobian[:, 1, k + at["start heading"]] = values[0]
            values = values + np.array([[x0], [y0]])
            jacobian[:, 0, k + at["start x"]] = jacobian[:, 1, k + at["start y"]] = 1.0
        elif sensor is Sensor.HEADING:
            values = values + psi0
            jacobian[:, 0, k + at["start heading"]] = 1.0
        elif self._errors[sensor]:
            seen = values, slopes, derivatives
            values, slopes, derivatives = (rows[: len(channels)].copy() for rows in seen)
            for error in self._errors[sensor]:
                size, c = b[at[error.name]], error.channel
                if error.factor is None:
                    values[c] += size
                else:
                    values[c] += size * seen[0][error.factor]
                    slopes[c] += size * seen[1][error.factor]
                    derivatives[c] += size * seen[2][error.factor]
                by_error = 1.0 if error.factor is None else seen[0][error.factor]
                jacobian[:, c, k + at[error.name]] = by_error
        jacobian[:, :, k + at[CLOCKS[sensor]]] = -slopes.T
        jacobian[:, :, k:] *= [nuisance.std for nuisance in self.nuisances]
        by_motion = np.swapaxes(derivatives, 0, 1)  # (m, c, k + 1 + e)
        moved = [*self._varied, *self._stepped]
        jacobian[:, :, :k] = by_motion[:, :, :k]
        jacobian[:, :, k + np.array(moved)] = by_motion[:, :, k:]
        residual = signal.values - values.T
        return Prediction(sensor, signal.time, values.T, residual, -jacobian, channels)

    def friction_used(self, z: FloatArray) -> float:
        """Return the largest share of its friction limit that a wheel uses; NaN: not known.

        Parameters
        ----------
        z : ndarray of float, shape (k,)
            Parameters in their ranges.
        """
        run = self._unaffected.run(self.parameters(z)[np.newaxis], ("x",))
        return float(run.feasibility.friction.value[0]) if run.groups.size else math.nan

    def misfits(self, Z: FloatArray, white: dict[Sensor, float]) -> FloatArray:
        """Return a rough misfit (n,) of parameters, for the choice of starts.

        Squared residuals of some samples divided by the white variance, with the nuisances that fit
        best: a wrong start heading would otherwise hide the right parameters.

        Parameters
        ----------
        Z : ndarray of float, shape (n, k)
            Parameters in their ranges.
        white : dict of Sensor to float
            Standard deviation of the white noise of each sensor.
        """
        motion = self._motion(self._unaffected, self.parameters(Z))
        signals = {sensor: _thinned(signal) for sensor, signal in self.drive.signals.items()}
        return np.array([self._misfit(motion.one(i), signals, white) for i in range(len(Z))])

    def _misfit(
        self, motion: Motions, signals: dict[Sensor, Signal], white: dict[Sensor, float]
    ) -> float:
        k, q = len(self.low), len(self.nuisances)
        b = np.array([nuisance.mean for nuisance in self.nuisances])
        gram = np.diag(np.append(np.ones(q), 0.0))  # of nuisances and residual
        for sensor, signal in signals.items():
            columns, slopes = motion.sensed(sensor, signal.time)
            moved = k + len(self._varied) + len(self._stepped)
            derivatives = np.zeros((len(columns), len(signal.time), moved))
            p = self._assemble(sensor, signal, columns[..., 0], slopes, derivatives, b)
            part = np.concatenate([p.jacobian[:, :, k:], p.residual[:, :, np.newaxis]], axis=2)
            part = part.reshape(-1, q + 1) / white[sensor]
            gram += part.T @ part
        reduced = np.linalg.solve(gram[:-1, :-1], gram[:-1, -1])
        return float(gram[-1, -1] - gram[:-1, -1] @ reduced)


def _columns_of(drive: MeasuredDrive) -> dict[Sensor, list[str]]:
    """Columns of the simulation that sensors see which not every drive has, by sensor."""
    found = {
        Sensor.LATERAL_ACCELERATION: ["lateral_acceleration"],
        Sensor.MOTOR_TORQUE: ["motor_torque"],
    }
    if (speeds := drive.signals.get(Sensor.WHEEL_SPEEDS)) is not None:
        found[Sensor.WHEEL_SPEEDS] = [f"wheel_speed_{wheel}" for wheel in speeds.wheels]
    return {sensor: names for sensor, names in found.items() if sensor in drive.signals}


def _sped(
    later: FloatArray, more: FloatArray, setpoints: FloatArray, measured: FloatArray
) -> FloatArray:
    """Speeds (n, t) by which set-points (t - 1,) are others, measured so late, and so much less."""
    ticks = TICK * np.arange(len(setpoints))
    moving = np.abs(measured) > RESTING
    rows = [
        np.interp(ticks + delay, ticks, measured) + off * moving - setpoints
        for delay, off in zip(later, more, strict=True)
    ]
    return np.pad(rows, ((0, 0), (0, 1)), mode="edge")


def _at_start(knots: FloatArray, time: FloatArray) -> FloatArray:
    """Deviation of a start [m/s] at times (t,), (n, t), by its inner knots (n, k)."""
    faster = np.zeros((len(knots), len(time)))
    early = time < START[-1]
    for row, inner in zip(faster, knots, strict=True):
        row[early] = np.interp(time[early], START, [0.0, *inner, 0.0])
    return faster


def _thinned(signal: Signal) -> Signal:
    """Some 200 samples of a signal."""
    step = max(1, len(signal.time) // 200)
    return dataclasses.replace(signal, time=signal.time[::step], values=signal.values[::step])


def restrict(vehicle: Vehicle, parameters: Sequence[str]) -> Vehicle:
    """Return the vehicle with only these parameters unknown, the others at their nominal values.

    Parameters
    ----------
    vehicle : Vehicle
        With at least these unknown parameters.
    parameters : sequence of str
        Names.

    Raises
    ------
    IdentificationError
        If one is not unknown, or none is left.
    """
    if isinstance(parameters, str):  # a sequence, too: of letters
        raise IdentificationError(f"parameters: a list of names is needed, as [{parameters!r}]")
    for name in parameters:
        if name not in vehicle.unknown:
            raise IdentificationError(
                f"{name!r} is not an unknown parameter of {vehicle.name}; there are: "
                f"{', '.join(vehicle.unknown) or 'none'}"
            )
    if not parameters:
        raise IdentificationError(f"{vehicle.name}: no unknown parameter: nothing to identify")
    unknown = {name: vehicle.unknown[name] for name in vehicle.unknown if name in parameters}
    return dataclasses.replace(vehicle, unknown=unknown)
