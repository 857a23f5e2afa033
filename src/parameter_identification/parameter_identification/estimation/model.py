"""Model of a drive: its signals, with their derivatives by parameters and nuisances.

One batch of the simulator gives the motion and its finite differences: k + 2 vehicles, the nominal
of the moment, one per parameter, one for the start speed; eight lanes cost what one does. The other
nuisances act on the motion in closed form: start pose (a rigid motion), time offsets of the clocks
(a derivative by time), gyro bias (a constant).

All variables are scaled to be of the order 1: parameters in their ranges (0 to 1), a nuisance in
the standard deviation of its prior. Letters of shapes: `k` parameters, `q` nuisances of
the drive, `m` samples, `t` ticks.
"""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from parameter_identification.drives.measured import MeasuredDrive, Sensor, Signal, StartPose
from tricycle_core.errors import IdentificationError
from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.batch import CommandedBatch

STEP = 1e-4  # of the finite differences by parameters, in ranges
SPEED_STEP = 1e-3  # m/s

# Standard deviations of the nuisances' priors
START_SPEED = 0.02  # m/s: the vehicle should stand still, or its speed was measured
TIME_OFFSET = 0.05  # s, of each clock against the commands'
GYRO_BIAS = 0.02  # rad/s

CLOCKS = {  # position and heading come from one localisation
    Sensor.POSITION: "pose delay",
    Sensor.HEADING: "pose delay",
    Sensor.YAW_RATE: "gyro delay",
    Sensor.WHEEL_SPEED: "wheel delay",
}


@dataclass(frozen=True, eq=False)
class _Motions:
    """Motions of n vehicles from the origin, each (n, t) on the ticks."""

    x: FloatArray
    y: FloatArray
    heading: FloatArray
    yaw_rate: FloatArray
    wheel_speed: FloatArray

    def channels(self, sensor: Sensor) -> tuple[FloatArray, ...]:
        """What a sensor sees, one array per channel."""
        if sensor is Sensor.POSITION:
            return self.x, self.y
        if sensor is Sensor.HEADING:
            return (self.heading,)
        return (self.yaw_rate if sensor is Sensor.YAW_RATE else self.wheel_speed,)

    def sensed(self, sensor: Sensor, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What a sensor sees at times (m,): values (c, n, m), slopes (c, m) of the first motion."""
        held = sensor in (Sensor.YAW_RATE, Sensor.WHEEL_SPEED)
        seen = [_interpolate(rows, time, held=held) for rows in self.channels(sensor)]
        values, slopes = zip(*seen, strict=True)
        return np.array(values), np.array(slopes)

    def one(self, i: int) -> "_Motions":
        """One of the motions, as n = 1."""
        rows = (self.x, self.y, self.heading, self.yaw_rate, self.wheel_speed)
        return _Motions(*(row[i : i + 1] for row in rows))


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
    """

    name: str
    unit: str
    mean: float
    std: float


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
    """

    sensor: Sensor
    time: FloatArray
    values: FloatArray
    residual: FloatArray
    jacobian: FloatArray


class DriveModel:
    """The model of one measured drive.

    Parameters
    ----------
    vehicle : Vehicle
        With the parameters to identify as its only unknown ones.
    drive : MeasuredDrive
        Commands and signals.
    """

    def __init__(self, vehicle: Vehicle, drive: MeasuredDrive) -> None:
        self.vehicle, self.drive = vehicle, drive
        self.low, high = np.array(list(vehicle.unknown.values())).T
        self.width = high - self.low
        self._batch = CommandedBatch(vehicle, drive.commands, setpoint=drive.start.speed)
        self.nuisances = self._nuisances()
        self._at = {nuisance.name: i for i, nuisance in enumerate(self.nuisances)}

    def _nuisances(self) -> tuple[Nuisance, ...]:
        x, y, heading = self._start_guess()
        start = self.drive.start
        found = [
            Nuisance("start x", "m", x, start.position_std),
            Nuisance("start y", "m", y, start.position_std),
            Nuisance("start heading", "rad", heading, start.heading_std),
            Nuisance("start speed", "m/s", start.speed, START_SPEED),
        ]
        clocks = dict.fromkeys(CLOCKS[sensor] for sensor in self.drive.signals)
        found += [Nuisance(clock, "s", 0.0, TIME_OFFSET) for clock in clocks]
        if Sensor.YAW_RATE in self.drive.signals:
            found.append(Nuisance("gyro bias", "rad/s", 0.0, GYRO_BIAS))
        return tuple(found)

    def _start_guess(self) -> tuple[float, float, float]:
        """Start pose if known, else from the first second, or of the best rigid motion."""
        start: StartPose = self.drive.start
        motion = self._motion(self.vehicle.nominal_point()[np.newaxis])
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

    def _motion(self, parameters: FloatArray, speeds: FloatArray | None = None) -> "_Motions":
        """Motions of vehicles with parameters (n, k) from start speeds (n,), or the known one."""
        if speeds is None:
            speeds = np.full(len(parameters), self.drive.start.speed)
        names = ("x", "y", "yaw", "yaw_rate", "drive_speed")
        return _Motions(*self._batch.run(parameters, names, speed=speeds).columns.values())

    def predict(self, z: FloatArray, nuisances: FloatArray) -> list[Prediction]:
        """Predict all signals.

        Parameters
        ----------
        z : ndarray of float, shape (k,)
            Parameters in their ranges.
        nuisances : ndarray of float, shape (q,)
            Deviations from the means of their priors, in standard deviations.
        """
        k = len(z)
        b = np.array([n.mean + n.std * v for n, v in zip(self.nuisances, nuisances, strict=True)])
        speed = b[self._at["start speed"]]
        steps = np.where(z < 0.5, STEP, -STEP)
        points = np.repeat(z[np.newaxis], k + 2, axis=0)
        points[np.arange(1, k + 1), np.arange(k)] += steps
        speeds = np.append(np.full(k + 1, speed), speed + SPEED_STEP)
        motion = self._motion(self.parameters(points), speeds)
        differences = np.append(steps, SPEED_STEP / START_SPEED)[:, np.newaxis]
        predictions = []
        for sensor, signal in self.drive.signals.items():
            delay = b[self._at[CLOCKS[sensor]]]
            columns, slopes = motion.sensed(sensor, signal.time - delay)  # (c, k + 2, m), (c, m)
            derivatives = (columns[:, 1:] - columns[:, :1]) / differences
            predictions.append(
                self._assemble(sensor, signal, columns[:, 0], slopes, derivatives, b)
            )
        return predictions

    def _assemble(
        self,
        sensor: Sensor,
        signal: Signal,
        values: FloatArray,
        slopes: FloatArray,
        derivatives: FloatArray,
        b: FloatArray,
    ) -> Prediction:
        """Apply start pose, delay and bias to a motion.

        Values and their slopes per second are (c, m), derivatives by the parameters and the start
        speed (c, k + 1, m), the nuisances `b` (q,) in their units.
        """
        k = len(self.low)
        at = self._at
        x0, y0, psi0 = (b[at[name]] for name in ("start x", "start y", "start heading"))
        jacobian = np.zeros((len(signal.time), len(values), k + len(b)))
        if sensor is Sensor.POSITION:
            turn = np.array([[math.cos(psi0), -math.sin(psi0)], [math.sin(psi0), math.cos(psi0)]])
            values, slopes = turn @ values, turn @ slopes
            derivatives = np.einsum("ij,jkm->ikm", turn, derivatives)
            jacobian[:, 0, k + at["start heading"]] = -values[1]
            jacobian[:, 1, k + at["start heading"]] = values[0]
            values = values + np.array([[x0], [y0]])
            jacobian[:, 0, k + at["start x"]] = jacobian[:, 1, k + at["start y"]] = 1.0
        elif sensor is Sensor.HEADING:
            values = values + psi0
            jacobian[:, 0, k + at["start heading"]] = 1.0
        elif sensor is Sensor.YAW_RATE:
            values = values + b[at["gyro bias"]]
            jacobian[:, 0, k + at["gyro bias"]] = 1.0
        jacobian[:, :, k + at[CLOCKS[sensor]]] = -slopes.T
        jacobian[:, :, k:] *= [nuisance.std for nuisance in self.nuisances]
        by_motion = np.moveaxis(derivatives, 2, 0)  # (m, c, k + 1)
        jacobian[:, :, :k] = by_motion[:, :, :k]
        jacobian[:, :, k + at["start speed"]] = by_motion[:, :, k]
        return Prediction(sensor, signal.time, values.T, signal.values - values.T, -jacobian)

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
        motion = self._motion(self.parameters(Z))
        signals = {sensor: _thinned(signal) for sensor, signal in self.drive.signals.items()}
        return np.array([self._misfit(motion.one(i), signals, white) for i in range(len(Z))])

    def _misfit(
        self, motion: "_Motions", signals: dict[Sensor, Signal], white: dict[Sensor, float]
    ) -> float:
        k, q = len(self.low), len(self.nuisances)
        b = np.array([nuisance.mean for nuisance in self.nuisances])
        gram = np.diag(np.append(np.ones(q), 0.0))  # of nuisances and residual
        for sensor, signal in signals.items():
            columns, slopes = motion.sensed(sensor, signal.time)
            derivatives = np.zeros((len(columns), k + 1, len(signal.time)))
            p = self._assemble(sensor, signal, columns[:, 0], slopes, derivatives, b)
            part = np.concatenate([p.jacobian[:, :, k:], p.residual[:, :, np.newaxis]], axis=2)
            part = part.reshape(-1, q + 1) / white[sensor]
            gram += part.T @ part
        reduced = np.linalg.solve(gram[:-1, :-1], gram[:-1, -1])
        return float(gram[-1, -1] - gram[:-1, -1] @ reduced)


def _thinned(signal: Signal) -> Signal:
    """Some 200 samples of a signal."""
    step = max(1, len(signal.time) // 200)
    return Signal(signal.time[::step], signal.values[::step])


def _interpolate(
    rows: FloatArray, time: FloatArray, *, held: bool
) -> tuple[FloatArray, FloatArray]:
    """Values of rows (n, t) on the ticks at times (m,), linearly, and the first row's slope.

    Before the start positions go on with their first slope and rates, `held`, do not change.
    """
    at = time / TICK
    left = np.clip(np.floor(at).astype(np.int64), 0, rows.shape[1] - 2)
    weight = at - left
    if held:
        weight = np.maximum(weight, 0.0)
    rise = rows[:, left + 1] - rows[:, left]
    return rows[:, left] + weight * rise, rise[0] / TICK * (weight > 0 if held else 1.0)


def restrict(vehicle: Vehicle, parameters: tuple[str, ...]) -> Vehicle:
    """Return the vehicle with only these parameters unknown, the others at their nominal values.

    Parameters
    ----------
    vehicle : Vehicle
        With at least these unknown parameters.
    parameters : tuple of str
        Names.

    Raises
    ------
    IdentificationError
        If one is not unknown, or none is left.
    """
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
