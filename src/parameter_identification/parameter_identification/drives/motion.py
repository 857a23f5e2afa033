"""Motion of the body in a recording: its poses, smoothed, on ticks."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.signal import savgol_filter

from parameter_identification.drives.following import FILTER
from parameter_identification.drives.smoothing import LEAST, smooth
from parameter_identification.drives.table import Recording
from tricycle_core.errors import IdentificationError
from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK

SLOWEST = 0.3  # m/s from which a turn shows the steering angle
TURNED = 0.1  # rad between the yaw and a smooth one, from which it jumps
LONGEST = 86_400.0  # s that are taken to ticks


@dataclass(frozen=True, eq=False)
class Motion:
    """A recording on ticks of 10 ms.

    Attributes
    ----------
    time, x, y, speed : ndarray of float, shape (t,)
        Times of the recording [s], position of the COM [m], and its forward speed [m/s].
    speed_std : float
        Standard deviation of the speed [m/s].
    missed : ndarray of float, shape (t,)
        Distance of the positions, hardly smoothed, from those that the speed belongs to [m].
    jolt : ndarray of float, shape (t,)
        Acceleration [m/s^2] of positions that are hardly smoothed: where they jump, no vehicle's.
    yaw, yaw_rate : ndarray of float, shape (t,)
        Yaw of the body and its rate [rad, rad/s]; where the recording has no yaw, those of the
        direction in which the COM moves.
    turned : ndarray of float, shape (t,)
        Difference of the yaw from the smoothed one [rad]: large where it jumps.
    """

    time: FloatArray
    x: FloatArray
    y: FloatArray
    speed: FloatArray
    speed_std: float
    missed: FloatArray
    jolt: FloatArray
    yaw: FloatArray
    yaw_rate: FloatArray
    turned: FloatArray


def motion_of(recording: Recording) -> Motion:
    """Return smoothed position, speed and yaw rate of a recording.

    The speed is that of splines which are as smooth as the noise of the positions asks for: a drive
    that is identified from it follows it.

    Parameters
    ----------
    recording : Recording
        Recording of at least 0.2 s and `LEAST` poses.

    Raises
    ------
    IdentificationError
        If it is shorter, or longer than a day.
    """
    if (length := recording.time[-1] - recording.time[0]) > LONGEST:
        gaps = np.diff(recording.time)
        longest = int(np.argmax(gaps))
        raise IdentificationError(
            f"{recording.name}: lasts {length:.3g} s, of which {gaps[longest]:.3g} s are between "
            f"two poses, {recording.time[longest]:.3g} s after the first one; at most "
            f"{LONGEST:g} s are read: mend the unit of time in the mapping, or the clock"
        )
    time = np.arange(recording.time[0], recording.time[-1], TICK)
    if len(time) < FILTER[0] or len(recording.time) < LEAST:
        unit = "; or is the unit of time wrong?" if len(recording.time) >= LEAST else ""
        raise IdentificationError(
            f"{recording.name}: has {len(recording.time)} poses in {length:.2g} s: needs {LEAST}, "
            f"and 0.2 s, at least{unit}"
        )
    (x, x_rate), (y, y_rate) = (
        _derivatives(np.interp(time, recording.time, v), 1) for v in (recording.x, recording.y)
    )
    positions = smooth(recording.time, recording.poses[:, :2])
    late = recording.pose_filter  # a low-pass takes its output plus this times the rate of that
    velocity = positions.spline.derivative()
    vx, vy = (velocity(time) + late * velocity.derivative()(time)).T
    off = recording.poses[:, :2] - positions.spline(recording.time)
    missed = np.hypot(*(savgol_filter(np.interp(time, recording.time, v), *FILTER) for v in off.T))
    if recording.yaw is None:
        yaw = np.unwrap(np.arctan2(vy, vx))
    else:
        yaw = np.interp(time, recording.time, recording.yaw)
    smoothed, turning, bend = _derivatives(yaw, 2)
    along = yaw + late * turning
    return Motion(
        time=time,
        x=x + late * x_rate,
        y=y + late * y_rate,
        speed_std=math.hypot(positions.slope_std, late * positions.bend_std),
        missed=missed,
        jolt=np.gradient(np.hypot(x_rate, y_rate), TICK),
        speed=vx * np.cos(along) + vy * np.sin(along),
        yaw=smoothed + late * turning,
        yaw_rate=turning + late * bend,
        turned=yaw - smoothed,
    )


def _derivatives(values: FloatArray, most: int) -> list[FloatArray]:
    """Values on ticks, smoothed, and their derivatives by time up to one."""
    return [savgol_filter(values, *FILTER, deriv=n, delta=TICK) for n in range(most + 1)]
