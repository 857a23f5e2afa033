"""Simulated motions of vehicles under the commands of one drive, as sensors see them."""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from parameter_identification.drives.measured import Sensor
from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands
from tricycle_sim.compilation import compiled
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.batch import Run


class Batch(Protocol):
    """Simulates samples of a vehicle under the same commands, as `CommandedBatch` does."""

    time: FloatArray

    @property
    def available(self) -> Collection[str]:
        """Names of the columns that it has."""
        ...

    def run(
        self,
        parameters: FloatArray,
        columns: Sequence[str],
        *,
        speed: FloatArray | None = None,
        steering_delay: FloatArray | None = None,
        drive_delay: float = 0.0,
        faster: FloatArray | None = None,
        steered: FloatArray | None = None,
    ) -> Run:
        """Return the columns of samples.

        Parameters
        ----------
        parameters : ndarray of float, shape (n, k)
            Values of the vehicle's unknown parameters in its order.
        columns : sequence of str
            Names of columns of a trajectory.
        speed : ndarray of float, shape (n,), optional
            Speed at which the samples roll at the start [m/s]; by default they are at rest.
        steering_delay : ndarray of float, shape (n,), optional
            Time by which each servo hears of its set-point later [s].
        drive_delay : float
            Time by which the motor hears of its set-point later [s].
        faster : ndarray of float, shape (n, t), optional
            Speed that is added to each motor's set-point [m/s].
        steered : ndarray of float, shape (n, t), optional
            Angle that is added to each servo's set-point [rad], heard later like it.
        """
        ...


class Simulator(Protocol):
    """Makes a `Batch`."""

    def __call__(self, vehicle: Vehicle, commands: Commands, *, setpoint: float = 0.0) -> Batch:
        """Return the batch that simulates a vehicle under commands."""
        ...


@dataclass(frozen=True, eq=False)
class Motions:
    """Motions of n vehicles from the origin on the ticks.

    Attributes
    ----------
    x, y, heading, yaw_rate, wheel_speed : ndarray of float, shape (n, t)
        Position, heading and yaw rate of `base_link` [m, m, rad, rad/s]; rotation rate of the
        driven wheel [rad/s].
    others : dict of Sensor to ndarray of float, shape (c, n, t)
        Values that the other sensors see, where they are measured.
    """

    x: FloatArray
    y: FloatArray
    heading: FloatArray
    yaw_rate: FloatArray
    wheel_speed: FloatArray
    others: dict[Sensor, FloatArray] = field(default_factory=dict, kw_only=True)

    @property
    def rows(self) -> tuple[FloatArray, ...]:
        """All but `others`."""
        return self.x, self.y, self.heading, self.yaw_rate, self.wheel_speed

    def seen(self, sensor: Sensor) -> Sequence[FloatArray]:
        """Return the rows (n, t) that a sensor sees, as `errors_of` says.

        Parameters
        ----------
        sensor : Sensor
            Sensor of which the drive has a signal.
        """
        if sensor is Sensor.LATERAL_ACCELERATION:
            return [*self.others[sensor], np.gradient(self.yaw_rate, TICK, axis=1)]
        if sensor in self.others:
            return list(self.others[sensor])
        x, y, heading, yaw_rate, wheel_speed = self.rows
        return {
            Sensor.POSITION: (x, y),
            Sensor.HEADING: (heading,),
            Sensor.YAW_RATE: (yaw_rate,),
            Sensor.WHEEL_SPEED: (wheel_speed,),
        }[sensor]

    def sensed(self, sensor: Sensor, time: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the values that a sensor sees at times, and their slopes.

        Parameters
        ----------
        sensor : Sensor
            Sensor of which the drive has a signal.
        time : ndarray of float, shape (m,)
            Times [s].

        Returns
        -------
        values : ndarray of float, shape (c, m, n)
            Rows that the sensor sees (`errors_of`) at the times, in each of the n motions.
        slopes : ndarray of float, shape (c, m)
            Their derivatives by time, of the first motion.
        """
        held = sensor not in (Sensor.POSITION, Sensor.HEADING)
        seen = [_interpolate(rows, time, held) for rows in self.seen(sensor)]
        values, slopes = zip(*seen, strict=True)
        return np.array(values), np.array(slopes)

    def with_another(self, more: "Motions") -> "Motions":
        """Return these motions and others after them.

        Parameters
        ----------
        more : Motions
            The others.
        """
        both = (np.concatenate(pair) for pair in zip(self.rows, more.rows, strict=True))
        others = {s: np.concatenate([own, more.others[s]], 1) for s, own in self.others.items()}
        return Motions(*both, others=others)

    def of(self, numbers: NDArray[np.int64] | Sequence[int]) -> "Motions":
        """Return some of the motions, copied.

        Parameters
        ----------
        numbers : ndarray or sequence of int
            Theirs; one may come more than once.
        """
        others = {sensor: rows[:, numbers] for sensor, rows in self.others.items()}
        return Motions(*(row[numbers] for row in self.rows), others=others)


@compiled
def _interpolate(rows: FloatArray, time: FloatArray, held: bool) -> tuple[FloatArray, FloatArray]:
    """Values (m, n) of rows (n, t) on the ticks at times (m,), linearly, and the first row's slope.

    Before the start positions go on with their first slope and rates, `held`, do not change.
    """
    values, slopes = np.empty((len(time), len(rows))), np.zeros(len(time))
    for j in range(len(time)):
        at = time[j] / TICK
        left = min(max(math.floor(at), 0), rows.shape[1] - 2)
        weight = max(at - left, 0.0) if held else at - left
        for i in range(len(rows)):
            values[j, i] = rows[i, left] + weight * (rows[i, left + 1] - rows[i, left])
        if weight > 0.0 or not held:
            slopes[j] = (rows[0, left + 1] - rows[0, left]) / TICK
    return values, slopes
