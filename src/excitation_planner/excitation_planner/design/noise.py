"""Noise of the measurement that a maneuver is designed for."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tricycle_core.errors import DesignError, PlanError
from tricycle_core.quantities import FloatArray

DELAY_STD = 0.05
"""Uncertainty of each sensor's clock [s]: the prior with which identification estimates it."""

STANDSTILL = 1.0
"""Time before the start that identification uses, too [s]: it tells start pose and gyro bias."""

GYRO_BIAS_STD = 0.02
"""Standard deviation of a gyro's constant offset [rad/s]: identification's prior of it."""


@dataclass(frozen=True)
class TrajectoryErrorNoise:
    """Variance that noise of the measured position gives to a trajectory error (Eq. 14).

    ``V_n = 4 std² (E[TE] + std²) / points``

    Attributes
    ----------
    std : float
        Standard deviation of the position noise per axis [m].
    points : int
        Number of independent noise values in a trajectory. 1 bounds noise so slow that it is a
        constant offset.

    Raises
    ------
    DesignError
        If the deviation is negative or infinite, or `points` less than 1.
    """

    std: float
    points: int = 1

    def __post_init__(self) -> None:
        if not (0 <= self.std < math.inf and self.points >= 1):
            raise DesignError("noise: std must not be negative, points at least 1")

    def __call__(self, m: FloatArray) -> float:
        """V_n [m⁴] from trajectory errors m (n,) [m²] of one maneuver; failed ones are NaN."""
        return float(4 * self.std**2 * (np.nanmean(m) + self.std**2) / self.points)


@dataclass(frozen=True)
class TrajectoryNoise:
    """Noise of a measured trajectory, and its further unknowns: start pose, clocks, offsets.

    Attributes
    ----------
    std : float or tuple of float, length c
        White noise per channel, in the unit of the channel; default 1 cm.
    drift_std, drift_time : float
        Standard deviation and correlation time [s] of a slow drift of the first two channels.
    period : float
        Time between trajectory points [s].
    start_position_std, start_heading_std : float
        Standard deviation of the start pose [m per axis, rad]; 0: known exactly. Channels 0 and 1
        are then x and y [m].
    heading_channel : int, optional
        Channel that is the heading [rad] and turns with the start pose.
    delay_std : float
        Standard deviation of the clock offset of the start pose's channels, and of each further
        channel, relative to the maneuver's clock [s]; 0: exact.
    bias_std : float or tuple of float
        Standard deviation of a constant offset of each further channel, e.g. of a gyro; 0: none.
        One for all of them, or one each.

    Raises
    ------
    DesignError
        If a standard deviation or time is impossible.
    """

    std: float | tuple[float, ...] = 0.01
    drift_std: float = 0.0
    drift_time: float = 5.0
    period: float = 0.05
    start_position_std: float = 0.0
    start_heading_std: float = 0.0
    heading_channel: int | None = None
    delay_std: float = 0.0
    bias_std: float | tuple[float, ...] = 0.0

    def __post_init__(self) -> None:
        if not (np.all(np.asarray(self.std) > 0) and np.all(np.isfinite(self.std))):
            raise DesignError(f"noise: std = {self.std} must be positive")
        for name in (
            *("drift_std", "start_position_std", "start_heading_std"),
            *("delay_std", "bias_std"),
        ):
            values = np.asarray(getattr(self, name))
            if not np.all((values >= 0) & (values < math.inf)):
                raise DesignError(f"noise: {name} = {getattr(self, name)} must not be negative")
        if not (self.drift_time > 0 and self.period > 0):
            raise DesignError("noise: drift_time and period must be positive")

    def check_channels(self, times: int, channels: int) -> None:
        """Refuse trajectories that this noise does not fit.

        Parameters
        ----------
        times, channels : int
            Number of time points and of channels of a trajectory.

        Raises
        ------
        DesignError
            If the noise does not fit the channels; the message says what.
        """
        posed = {0, 1} | ({self.heading_channel} - {None})
        start = self.start_position_std > 0 or self.start_heading_std > 0
        if np.size(self.std) not in (1, channels):
            what = f"{np.size(self.std)} std"
        elif np.size(self.bias_std) not in (1, channels - len(posed)):
            what = f"{np.size(self.bias_std)} bias_std, for those that are no pose,"
        elif start and channels < 2:
            what = "a start pose (x and y)"
        elif self.heading_channel is not None and not 2 <= self.heading_channel < channels:
            what = f"heading_channel = {self.heading_channel}"
        elif self.delay_std > 0 and times < 2:
            what = "delay_std"
        else:
            return
        raise DesignError(f"noise: {what} does not fit {times} time points of {channels} channels")


NOISE_FIELDS = {
    "noise_std": ("m", "of the position per axis; 0: the paper's cost"),
    "heading_std": ("rad", "of the heading; 0: it is not measured"),
    "pose_rate": ("Hz", "rate of position and heading"),
    "yaw_rate_std": ("rad/s", "of a yaw-rate gyro; 0: there is none"),
    "gyro_rate": ("Hz", "rate of the gyro"),
    "wheel_speed_std": ("rad/s", "of the rear wheel's speed; 0: it is not measured"),
    "wheel_rate": ("Hz", "rate of the wheel speed"),
    "drift_std": ("m", "of a slow drift of the position"),
    "drift_time": ("s", "correlation time of that drift"),
    "start_position_std": ("m", "of the start position per axis"),
    "start_heading_std": ("rad", "of the start heading"),
}
"""Unit and meaning of each field of `MeasurementNoise`, for options and parameters of nodes."""


@dataclass(frozen=True)
class MeasurementNoise:
    """Noise of a drive's measurement: what a plan assumes about the sensors and the start pose.

    Attributes
    ----------
    noise_std : float
        White noise of the measured position per axis [m]; 0 is the paper's cost.
    heading_std : float
        White noise of the measured heading [rad]; 0: it is not measured.
    pose_rate : float
        Sampling rate of position and heading [Hz].
    yaw_rate_std : float
        White noise of a yaw-rate gyro [rad/s]; 0: there is none.
    gyro_rate : float
        Sampling rate of the gyro [Hz].
    wheel_speed_std : float
        White noise of the rear wheel's speed [rad/s]; 0: it is not measured.
    wheel_rate : float
        Sampling rate of the wheel speed [Hz]. Identification counts rounded readings of a second as
        one.
    drift_std, drift_time : float
        Standard deviation [m] and correlation time [s] of a slow drift of the position.
    start_position_std, start_heading_std : float
        Standard deviation of the start pose [m per axis, rad]. A design for a start pose that is
        known exactly (0) is a poor one when it is not.

    Raises
    ------
    PlanError
        If a deviation is not from 0 to 10, or a correlation time or rate not above 0.
    """

    noise_std: float = 0.01
    heading_std: float = 0.0
    pose_rate: float = 20.0
    yaw_rate_std: float = 0.0
    gyro_rate: float = 20.0
    wheel_speed_std: float = 0.0
    wheel_rate: float = 20.0
    drift_std: float = 0.0
    drift_time: float = 5.0
    start_position_std: float = 0.02
    start_heading_std: float = 0.0175

    def __post_init__(self) -> None:
        for name, (unit, _) in NOISE_FIELDS.items():
            value = getattr(self, name)
            if name.endswith("_std"):
                if not 0.0 <= value <= 10.0:
                    raise PlanError(f"{name} = {value:g} {unit} must be from 0 to 10")
            elif not 0.0 < value <= 1e4:
                raise PlanError(f"{name} = {value:g} {unit} must be above 0, at most 1e4")

    @property
    def position_std(self) -> float:
        """Standard deviation of one measured position per axis, drift included [m]."""
        return math.hypot(self.noise_std, self.drift_std)

    @property
    def channels(self) -> tuple[str, ...]:
        """Measured channels, by the names of `tricycle_sim.vehicle.batch.Trajectory`."""
        measured = {
            "yaw": self.heading_std,
            "yaw_rate": self.yaw_rate_std,
            "drive_speed": self.wheel_speed_std,
        }
        return ("x", "y", *(channel for channel, std in measured.items() if std))

    @property
    def of_trajectory(self) -> TrajectoryNoise:
        """Noise of these channels, for the criteria C, D and A."""
        # white noise of samples at another rate than the trajectory's points: the same information
        period = TrajectoryNoise.period
        pose, gyro, wheel = (
            1.0 / math.sqrt(rate * period)
            for rate in (self.pose_rate, self.gyro_rate, self.wheel_rate)
        )
        std = {
            "x": pose * self.noise_std,
            "y": pose * self.noise_std,
            "yaw": pose * self.heading_std,
            "yaw_rate": gyro * self.yaw_rate_std,
            "drive_speed": wheel * self.wheel_speed_std,
        }
        bias = {"yaw_rate": GYRO_BIAS_STD, "drive_speed": 0.0}
        return TrajectoryNoise(
            std=tuple(std[channel] for channel in self.channels),
            heading_channel=2 if self.heading_std else None,
            drift_std=self.drift_std,
            drift_time=self.drift_time,
            start_position_std=self.start_position_std,
            start_heading_std=self.start_heading_std,
            delay_std=DELAY_STD,
            bias_std=tuple(bias[channel] for channel in self.channels if channel in bias),
        )

    @property
    def of_trajectory_error(self) -> TrajectoryErrorNoise:
        """Noise of TE, for the criterion H: the worst case, a constant offset of the position."""
        return TrajectoryErrorNoise(self.noise_std)

    def __str__(self) -> str:
        """List the sensors, with deviations and rates."""
        pose = [f"position ± {1e3 * self.noise_std:g} mm"]
        if self.heading_std:
            pose.append(f"heading ± {1e3 * self.heading_std:g} mrad")
        sensors = [f"{' and '.join(pose)} at {self.pose_rate:g} Hz"]
        if self.yaw_rate_std:
            sensors.append(f"gyro ± {1e3 * self.yaw_rate_std:g} mrad/s at {self.gyro_rate:g} Hz")
        if self.wheel_speed_std:
            sensors.append(
                f"wheel ± {1e3 * self.wheel_speed_std:g} mrad/s at {self.wheel_rate:g} Hz"
            )
        return ", ".join(sensors)


SIMULATED = MeasurementNoise(
    noise_std=0.01,
    heading_std=0.002,
    pose_rate=100.0,
    yaw_rate_std=0.005,
    gyro_rate=100.0,
    wheel_speed_std=0.001,
    wheel_rate=1.0,
)
"""Measurement noise of the simulation unless its parameters are set.

`joint_states` come at 100 Hz, rounded to 1 mm/s; identification counts those of a second as one.
"""
