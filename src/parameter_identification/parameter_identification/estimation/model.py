"""Model of a drive: its signals, with their derivatives by parameters and nuisances.

`MotionModel` tells how the vehicle moves. What is seen of that is changed in closed form: by the
start pose (a rigid motion), the delays of the clocks (a derivative by time) and the errors of the
sensors (linear in what they see).

All variables are scaled to be of the order 1: parameters in their ranges (0 to 1), a nuisance in
the standard deviation of its prior. Letters of shapes: `k` parameters, `q` nuisances of the drive,
`m` samples, `c` channels, `e` nuisances that the motion is differentiated by.
"""

import dataclasses
import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from excitation_planner.design.noise import DELAY_STD
from parameter_identification.drives.measured import (
    Input,
    MeasuredDrive,
    Sensor,
    Signal,
    StartPose,
)
from parameter_identification.estimation.instruments import CLOCKS, errors_of
from parameter_identification.estimation.motion_model import MotionModel
from parameter_identification.estimation.motions import Motions, Simulator
from parameter_identification.estimation.nuisance import InUnits, Nuisance
from tricycle_core.quantities import FloatArray
from tricycle_sim.effects import Effect
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.batch import CommandedBatch

NEAR = 0.01, 0.05  # changes of parameters, nuisances that hardly change the derivatives


@dataclass(frozen=True, eq=False)
class Prediction:
    """A signal of a drive against the model.

    Attributes
    ----------
    sensor : Sensor
        Sensor whose signal is predicted.
    time : ndarray of float, shape (m,)
        Times of the samples [s].
    values : ndarray of float, shape (m, c)
        Predicted.
    residual : ndarray of float, shape (m, c)
        Measured less predicted.
    jacobian : ndarray of float, shape (m, c, k + q)
        Derivatives of the residual by all variables: k parameters, then q nuisances.
    channels : tuple of str
        Names of the columns.
    """

    sensor: Sensor
    time: FloatArray
    values: FloatArray
    residual: FloatArray
    jacobian: FloatArray
    channels: tuple[str, ...]

    @property
    def rms(self) -> float:
        """Root mean square of the residual's length over the samples, in the sensor's unit."""
        return float(np.sqrt(np.mean(np.sum(self.residual**2, axis=1))))


class DriveModel:
    """The model of one measured drive.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle in which the parameters to identify are the only unknown ones.
    drive : MeasuredDrive
        Commands and signals.
    effects : sequence of Effect, optional
        Estimated beside the parameters.
    simulator : callable
        Makes of vehicle, commands and speed before them what simulates samples of the vehicle.
    measured : collection of Input
        Inputs that move as measured where the drive tells them, not as commanded. A wheel that does
        so is no sensor any more, and `OF_INPUT` has no effect.

    Attributes
    ----------
    motion : MotionModel
        Motion of the vehicle on the drive.
    drive : MeasuredDrive
        Drive with the signals that are compared (`MotionModel.drive`).
    low, width : ndarray of float, shape (k,)
        Lower ends and widths of the parameters' ranges, in the parameters' units.
    shared : int
        Number of nuisances, the first ones, that all drives have in common.
    nuisances : tuple of Nuisance
        All nuisances: those of the motion, then those of what is seen of it.
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
        self.vehicle, self.effects, self._simulator = vehicle, tuple(effects), simulator
        self.motion = MotionModel(vehicle, drive, effects, simulator, measured)
        self.drive = self.motion.drive
        self.low, self.width = self.motion.low, self.motion.width
        self.shared = sum(not e.per_drive for e in effects)
        self._errors = {s: errors_of(s, signal) for s, signal in self.drive.signals.items()}
        seen = (*self._of_start_pose(), *self._of_sensors())
        self.nuisances = (*self.motion.nuisances, *seen)
        self._in_units = InUnits(self.nuisances)
        self._at = {nuisance.name: i for i, nuisance in enumerate(self.nuisances)}
        # what the derivatives of the motion depend on: all that moves, and when it is seen
        clocks = [self._at[CLOCKS[sensor]] for sensor in self.drive.signals]
        self._moving = [*range(len(self.motion.nuisances)), *sorted(set(clocks))]
        # the last ones by sensor, and the point (z, moving nuisances) that they are of
        self._derivatives: tuple[tuple[FloatArray, ...], dict[Sensor, FloatArray]] = (), {}

    def of(self, drive: MeasuredDrive) -> "DriveModel":
        """Return the same model of another drive.

        Parameters
        ----------
        drive : MeasuredDrive
            Drive of the same vehicle.
        """
        return DriveModel(
            self.vehicle, drive, self.effects, self._simulator, measured=self.motion.measured
        )

    def _of_start_pose(self) -> tuple[Nuisance, ...]:
        start, guess = self.drive.start, self._start_guess()
        return (
            Nuisance("start x", "m", guess[0], start.position_std),
            Nuisance("start y", "m", guess[1], start.position_std),
            Nuisance("start heading", "rad", guess[2], start.heading_std),
        )

    def _of_sensors(self) -> Iterator[Nuisance]:
        """Delays of the clocks and errors of the sensors."""
        for clock in dict.fromkeys(CLOCKS[sensor] for sensor in self.drive.signals):
            yield Nuisance(clock, "s", 0.0, DELAY_STD)
        for error in chain.from_iterable(self._errors.values()):
            yield Nuisance(error.name, error.unit, 0.0, error.std)

    def _start_guess(self) -> tuple[float, float, float]:
        """Start pose, as far as it is not known where the nominal vehicle's fits the samples.

        The heading fits the first samples of a heading sensor, or the positions of the first half
        of the drive or 5 s; the place fits those where the vehicle has hardly moved.
        """
        start: StartPose = self.drive.start
        motion = self.motion.unaffected(self.nominal[np.newaxis])
        position = self.drive.signals[Sensor.POSITION]
        early = position.time <= position.time[0] + max(5.0, 0.5 * float(np.ptp(position.time)))
        time = position.time[early]
        ticks = self.motion.time
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

    @property
    def nominal(self) -> FloatArray:
        """Nominal parameters in their ranges, shape (k,)."""
        nominal: FloatArray = (self.vehicle.nominal_point() - self.low) / self.width
        return nominal

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
        of_motion = nuisances[: len(self.motion.nuisances)]
        point, kept = self._derivatives
        here = z, nuisances[self._moving]
        near = bool(kept) and all(
            np.all(np.abs(now - then) <= limit)
            for now, then, limit in zip(here, point, NEAR, strict=True)
        )
        if near:
            motion, lengths = self.motion.motion(z, of_motion), np.empty(0)
        else:
            motion, lengths = self.motion.steps(z, of_motion)
        found = {}
        for sensor, signal in self.drive.signals.items():
            delay = b[self._at[CLOCKS[sensor]]]
            columns, slopes = motion.sensed(sensor, signal.time - delay)  # (c, m, lanes), (c, m)
            derivatives = (columns[..., 1:] - columns[..., :1]) / lengths
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
        motion = self.motion.motion(z, nuisances[: len(self.motion.nuisances)])
        rows = (motion.wheel_speed[0], motion.yaw_rate[0], motion.heading[0])
        rate, yaw_rate, heading = (np.interp(time, self.motion.time, row) for row in rows)
        speed = self.vehicle.driven_radius * rate
        commands = self.drive.commands
        held = np.searchsorted(commands.time, time + 1e-9, side="right") - 1
        steering = commands.steering_motor_angle[np.maximum(held, 0)]
        start = self._in_units(nuisances)[self._at["start heading"]]
        return np.array([speed, steering, speed * yaw_rate, heading + start])

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

        Values and their slopes per second are (c, m), derivatives by the parameters and what the
        motion is differentiated by (c, m, k + e), the nuisances `b` (q,) in their units.
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
        jacobian[:, :, k:] *= self._in_units.deviations
        by_motion = np.swapaxes(derivatives, 0, 1)  # (m, c, k + e)
        jacobian[:, :, :k] = by_motion[:, :, :k]
        jacobian[:, :, k + self.motion.lanes] = by_motion[:, :, k:]
        residual = signal.values - values.T
        return Prediction(sensor, signal.time, values.T, residual, -jacobian, channels)

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
        motion = self.motion.unaffected(Z)
        signals = {sensor: _thinned(signal) for sensor, signal in self.drive.signals.items()}
        return np.array([self._misfit(motion.of([i]), signals, white) for i in range(len(Z))])

    def _misfit(
        self, motion: Motions, signals: dict[Sensor, Signal], white: dict[Sensor, float]
    ) -> float:
        k, q = len(self.low), len(self.nuisances)
        b = self._in_units.means
        gram = np.diag(np.append(np.ones(q), 0.0))  # of nuisances and residual
        for sensor, signal in signals.items():
            columns, slopes = motion.sensed(sensor, signal.time)
            lanes = k + len(self.motion.lanes)
            derivatives = np.zeros((len(columns), len(signal.time), lanes))
            p = self._assemble(sensor, signal, columns[..., 0], slopes, derivatives, b)
            part = np.concatenate([p.jacobian[:, :, k:], p.residual[:, :, np.newaxis]], axis=2)
            part = part.reshape(-1, q + 1) / white[sensor]
            gram += part.T @ part
        reduced = np.linalg.solve(gram[:-1, :-1], gram[:-1, -1])
        return float(gram[-1, -1] - gram[:-1, -1] @ reduced)


def _thinned(signal: Signal) -> Signal:
    """Some 200 samples of a signal."""
    every = max(1, len(signal.time) // 200)
    return dataclasses.replace(signal, time=signal.time[::every], values=signal.values[::every])
