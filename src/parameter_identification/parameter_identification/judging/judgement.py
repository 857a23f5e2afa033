"""JUDGE: the trajectory error of a recorded drive against its reference (Eq. 14), from its bag.

In time, the recorded start event ties the measured poses to the reference. In space, the reference
starts at the *anchor*, by default the mean measured pose of the standstill before the start
event. Neither is fitted: the error with another anchor, and the time by which the vehicle seems to
lag behind the reference, are reported and not applied.

The measured trajectory is interpolated linearly to the 10 000 points of Eq. 14 (at 100 Hz and
0.5 m/s² of lateral acceleration that is wrong by 6 µm), the reference by a cubic spline.
"""

from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import numpy as np

from excitation_planner.trajectory_error import POINTS, trajectory_error
from parameter_identification.drives.poses import Datum, PlanarTrajectory
from parameter_identification.drives.proportion import path_contradiction
from parameter_identification.drives.reader import read_drive
from parameter_identification.drives.recorded import RecordedDrive, TopicNames
from parameter_identification.drives.samples import MAX_GAP
from parameter_identification.judging.spline import CubicSpline
from tricycle_core.errors import JudgeError
from tricycle_core.quantities import FloatArray

__all__ = [
    "Anchor", "Datum", "JudgeError", "Judgement", "PlanarPose", "TimeSeries", "TopicNames", "judge",
    "judge_drive",
]  # fmt: skip


ANCHORED = 1.0  # s before the start event that give the anchor
MIN_ANCHORED = 0.3  # s of them that must be recorded
MAX_CREEP = 0.05  # m/s of a vehicle that stands
TURNING = 1.0  # rad of heading from which the reference and its mirror image are told apart
UNIT = 2.5  # factor from which positions are in another unit
STRAIGHT = 0.1  # rad of heading up to which the drive is straight, for the time offset


class Anchor(Enum):
    """Ways to find the pose of the reference's origin in the frame of the measured poses."""

    STANDSTILL = "standstill"  # mean pose before the start event
    START = "start"  # the single pose at the start event
    FIT = "fit"  # least squares over the whole drive


@dataclass(frozen=True)
class PlanarPose:
    """Planar pose in the frame of the measured poses.

    Attributes
    ----------
    x, y : float
        Position [m].
    heading : float
        Left positive [rad].
    """

    x: float
    y: float
    heading: float


@dataclass(frozen=True)
class TimeSeries:
    """The drive at the points of Eq. 14, in the frame of the reference (x: heading at the start).

    Attributes
    ----------
    time : ndarray of float, shape (j,)
        Times since the start event [s].
    x, y, heading : ndarray of float, shape (j,)
        Measured [m] and [rad].
    reference_x, reference_y, reference_heading : ndarray of float, shape (j,)
        Position and heading of the reference [m] and [rad].
    along, cross : ndarray of float, shape (j,)
        Deviation along the reference's heading and to its left [m].
    heading_error : ndarray of float, shape (j,)
        Deviation of the heading [rad]; NaN for a sensor without heading.
    """

    time: FloatArray
    x: FloatArray
    y: FloatArray
    heading: FloatArray
    reference_x: FloatArray
    reference_y: FloatArray
    reference_heading: FloatArray
    along: FloatArray
    cross: FloatArray
    heading_error: FloatArray

    @property
    def distance(self) -> FloatArray:
        """Distance from the reference (j,) [m]."""
        return np.hypot(self.along, self.cross)


@dataclass(frozen=True)
class Judgement:
    """Trajectory error of one drive, with its uncertainty and its components.

    Attributes
    ----------
    bag : Path
        Path of the bag that was judged.
    plan_id : str
        Identifier of the plan that was driven.
    te : float
        Trajectory error (Eq. 14) with the chosen anchor [m²].
    te_corrected : float
        `te` less the mean contribution of the measurement noise [m²]; it may come out negative.
    te_deviation : float
        Standard deviation of `te` from the noise of the anchor [m²].
    te_by_anchor : dict of Anchor to float
        Trajectory error with every anchor [m²].
    rms, max : float
        Root mean square and largest distance from the reference [m].
    rms_x, rms_y, rms_along, rms_cross : float
        Root mean squares of its components [m].
    rms_heading : float
        Root mean square of the deviation of the heading [rad]; NaN for a sensor without heading.
    duration : float
        Duration of the reference [s].
    anchor : Anchor
        The chosen one.
    anchor_pose : PlanarPose
        Pose of the reference's origin with that anchor.
    noise : float
        Standard deviation of a measured position, per axis [m].
    time_offset : float
        Time by which the drive seems to lag behind the reference [s]; NaN if unknown.
    time_offset_deviation : float
        Standard deviation of `time_offset` [s].
    series : TimeSeries
        The drive at the points of Eq. 14.
    """

    bag: Path
    plan_id: str
    te: float
    te_corrected: float
    te_deviation: float
    te_by_anchor: dict[Anchor, float]
    rms: float
    max: float
    rms_x: float
    rms_y: float
    rms_along: float
    rms_cross: float
    rms_heading: float
    duration: float
    anchor: Anchor
    anchor_pose: PlanarPose
    noise: float
    time_offset: float
    time_offset_deviation: float
    series: TimeSeries

    @property
    def contradiction(self) -> str:
        """What is wrong with the frame or the unit of the poses, by the reference; else ""."""
        s = self.series
        problem = path_contradiction(
            np.column_stack([s.x, s.y]),
            np.column_stack([s.reference_x, s.reference_y]),
            factor=UNIT,
            turns=float(np.ptp(s.reference_heading)) > TURNING,
        )
        return f"the positions {problem} the reference" if problem else ""


def judge(
    bag: Path | str, *, topics: TopicNames | None = None, anchor: Anchor = Anchor.STANDSTILL
) -> Judgement:
    """Compute the trajectory error of the drive in a bag.

    Parameters
    ----------
    bag : Path or str
        rosbag2 directory, ``.mcap`` or ``.db3`` file.
    topics : TopicNames, optional
        Names of the topics, where they differ from the suite's.
    anchor : Anchor
        Choice of where the reference starts; `Anchor.FIT` aligns it with the measured poses.

    Raises
    ------
    BagError
        If the bag cannot be read.
    JudgeError
        If the bag holds no drive that can be judged, or not all of it.
    """
    return judge_drive(read_drive(bag, topics=topics, sensors=False), anchor=anchor)


def judge_drive(drive: RecordedDrive, *, anchor: Anchor = Anchor.STANDSTILL) -> Judgement:
    """Compute the trajectory error of a drive that was read already.

    Parameters
    ----------
    drive : RecordedDrive
        From `read_drive`.
    anchor : Anchor
        Choice of where the reference starts.

    Raises
    ------
    JudgeError
        If poses are missing, the vehicle does not stand still before the start event, the anchor
        needs a heading that is not measured, or the maneuver was ended early.
    """
    if drive.ended_early is not None:
        raise JudgeError(
            f"{drive.bag}: the maneuver was ended early, after {drive.ended_early:.2f} s: its "
            "trajectory error is none of the whole maneuver; it can be identified from"
        )
    time = np.linspace(0.0, drive.duration, POINTS)
    _check_matched(drive, time)
    reference = _interpolate_reference(drive.reference, time)
    measured = _interpolate(drive.poses, time)
    standing = _standstill(drive)
    poses = {
        Anchor.STANDSTILL: _mean_pose(standing),
        Anchor.START: PlanarPose(measured.x[0], measured.y[0], measured.heading[0]),
        Anchor.FIT: _fit(measured, reference),
    }
    if np.isnan(poses[anchor].heading):
        raise JudgeError(
            f"{drive.bag}: the poses have no heading to anchor the reference by: use the anchor "
            f"{Anchor.FIT.value!r}"
        )
    te_by_anchor = {}
    for name, pose in poses.items():
        path = _in_frame(measured, pose)
        te_by_anchor[name] = trajectory_error(path.x, path.y, reference.x, reference.y)
    series = _series(_in_frame(measured, poses[anchor]), reference)
    te, distance = te_by_anchor[anchor], series.distance
    noise = _noise_variance(drive, poses[anchor])
    added, deviation = _noise_effect(drive.poses, standing, series, noise, anchor)
    offset, offset_deviation = _time_offset(drive, poses[anchor])

    def rms(values: FloatArray) -> float:
        return float(np.sqrt(np.mean(values**2)))

    return Judgement(
        bag=drive.bag,
        plan_id=drive.plan_id,
        te=te,
        te_corrected=te - added,
        te_deviation=deviation,
        te_by_anchor=te_by_anchor,
        rms=float(np.sqrt(te)),
        max=float(np.max(distance)),
        rms_x=rms(series.x - series.reference_x),
        rms_y=rms(series.y - series.reference_y),
        rms_along=rms(series.along),
        rms_cross=rms(series.cross),
        rms_heading=rms(series.heading_error),
        duration=drive.duration,
        anchor=anchor,
        anchor_pose=poses[anchor],
        noise=float(np.sqrt(noise / 2)),
        time_offset=offset,
        time_offset_deviation=offset_deviation,
        series=series,
    )


def _check_matched(drive: RecordedDrive, time: FloatArray) -> None:
    """Raise an error if a point is not between poses at most MAX_GAP apart."""
    known = drive.poses.time
    after = np.searchsorted(known, time, side="left")
    inside = (after < len(known)) & ((after > 0) | (time == known[0]))
    gap = np.full(len(time), np.inf)
    gap[inside] = known[after[inside]] - known[np.maximum(after[inside] - 1, 0)]
    matched = gap <= MAX_GAP
    if matched.all():
        return
    first = int(np.argmin(matched))
    length = int(np.argmax(matched[first:])) or len(time) - first
    cut = (
        ""
        if drive.complete
        else "; the bag was cut off, or messages were lost: identify takes it as far as it goes"
    )
    raise JudgeError(
        f"{drive.bag}: poses match {np.mean(matched):.1%} of the reference's "
        f"{drive.duration:.2f} s; there are none between {time[first]:.2f} s and "
        f"{time[first + length - 1]:.2f} s{cut}"
    )


def _standstill(drive: RecordedDrive) -> PlanarTrajectory:
    """Poses just before the start event; raises if there are none or the vehicle moves."""
    time = drive.poses.time
    standing = drive.poses.part((time >= -ANCHORED) & (time < 0))
    recorded = -standing.time[0] if len(standing.time) else 0.0
    if recorded < MIN_ANCHORED or len(standing.time) < 3:
        raise JudgeError(
            f"{drive.bag}: {recorded:.2f} s of standstill before the start event are recorded, "
            f"{MIN_ANCHORED} s are needed: start recording earlier"
        )
    t, x, y = standing.time, standing.x, standing.y
    creep = np.hypot(_slope(t, x), _slope(t, y))
    noise = np.hypot(_slope_deviation(t, x), _slope_deviation(t, y))
    if creep > MAX_CREEP + 4 * noise:
        raise JudgeError(
            f"{drive.bag}: the vehicle moves at {creep:.2f} m/s before the start event: it must "
            "stand still, for the anchor"
        )
    return standing


def _slope(time: FloatArray, values: FloatArray) -> float:
    centred = time - time.mean()
    return float(centred @ values / (centred @ centred))


def _slope_deviation(time: FloatArray, values: FloatArray) -> float:
    """Standard deviation of a slope fitted to white noise."""
    centred = time - time.mean()
    rest = values - values.mean() - _slope(time, values) * centred
    return float(np.sqrt(rest @ rest / max(len(time) - 2, 1) / (centred @ centred)))


def _mean_pose(path: PlanarTrajectory) -> PlanarPose:
    return PlanarPose(float(path.x.mean()), float(path.y.mean()), float(path.heading.mean()))


def _fit(measured: PlanarTrajectory, reference: PlanarTrajectory) -> PlanarPose:
    """Anchor of the smallest TE: least squares of a rotation and a translation (Umeyama 1991)."""
    z = measured.x + 1j * measured.y
    z0 = reference.x + 1j * reference.y
    rotation = np.vdot(z0 - z0.mean(), z - z.mean())
    heading = float(np.angle(rotation))
    origin = z.mean() - z0.mean() * np.exp(1j * heading)
    return PlanarPose(float(origin.real), float(origin.imag), heading)


def _in_frame(path: PlanarTrajectory, anchor: PlanarPose) -> PlanarTrajectory:
    """Path in the frame of the reference, whose origin lies at the anchor."""
    c, s = np.cos(anchor.heading), np.sin(anchor.heading)
    x, y = path.x - anchor.x, path.y - anchor.y
    return PlanarTrajectory(path.time, c * x + s * y, c * y - s * x, path.heading - anchor.heading)


def _interpolate(path: PlanarTrajectory, time: FloatArray) -> PlanarTrajectory:
    x, y, heading = (np.interp(time, path.time, v) for v in (path.x, path.y, path.heading))
    return PlanarTrajectory(time, x, y, heading)


def _interpolate_reference(path: PlanarTrajectory, time: FloatArray) -> PlanarTrajectory:
    x, y = (CubicSpline(path.time, v)(time) for v in (path.x, path.y))
    return PlanarTrajectory(time, x, y, np.interp(time, path.time, path.heading))


def _series(measured: PlanarTrajectory, reference: PlanarTrajectory) -> TimeSeries:
    c, s = np.cos(reference.heading), np.sin(reference.heading)
    dx, dy = measured.x - reference.x, measured.y - reference.y
    error = measured.heading - reference.heading
    return TimeSeries(
        time=reference.time,
        x=measured.x,
        y=measured.y,
        heading=measured.heading,
        reference_x=reference.x,
        reference_y=reference.y,
        reference_heading=reference.heading,
        along=c * dx + s * dy,
        cross=c * dy - s * dx,
        heading_error=np.angle(np.exp(1j * error)),
    )


def _residual(
    drive: RecordedDrive, anchor: PlanarPose
) -> tuple[PlanarTrajectory, PlanarTrajectory]:
    """Poses during the drive in the frame of the reference, and the reference at their times."""
    during = (drive.poses.time >= 0) & (drive.poses.time <= drive.duration)
    path = _in_frame(drive.poses.part(during), anchor)
    return path, _interpolate_reference(drive.reference, path.time)


def _noise_variance(drive: RecordedDrive, anchor: PlanarPose) -> float:
    """Variance of the white part of the position noise, both axes together, m².

    From third differences of the deviation, which is smooth but for the noise: those of white
    noise of variance σ² have variance 20 σ². Their mean square, not a robust median: TE is one as
    well, and outliers add to both.
    """
    path, reference = _residual(drive, anchor)
    if len(path.time) < 4:
        return 0.0
    return float(
        sum(
            np.mean(np.diff(a - b, 3) ** 2) / 20
            for a, b in ((path.x, reference.x), (path.y, reference.y))
        )
    )


def _noise_effect(
    poses: PlanarTrajectory,
    standing: PlanarTrajectory,
    series: TimeSeries,
    noise: float,
    anchor: Anchor,
) -> tuple[float, float]:
    """Mean that white noise adds to TE, and TE's standard deviation from the anchor's noise.

    A point between two poses with weights w and 1 - w has noise of variance (w² + (1-w)²) σ². An
    anchor that is the mean of n poses moves all points alike by noise of variance σ²/n and turns
    them by the heading's. A fitted anchor takes as much off as it adds, here neglected.
    """
    right = np.clip(np.searchsorted(poses.time, series.time), 1, len(poses.time) - 1)
    step = poses.time[right] - poses.time[right - 1]
    w = (series.time - poses.time[right - 1]) / step
    added = noise * float(np.mean(w**2 + (1 - w) ** 2))
    if anchor is Anchor.FIT:
        return added, 0.0
    n = len(standing.time) if anchor is Anchor.STANDSTILL else 1
    heading = float(np.nan_to_num(np.var(standing.heading, ddof=1)))
    radius = np.mean(series.reference_x**2 + series.reference_y**2)
    added += (noise + heading * float(radius)) / n
    dx, dy = series.x - series.reference_x, series.y - series.reference_y
    gradient_x, gradient_y = 2 * np.mean(dx), 2 * np.mean(dy)
    gradient_heading = 2 * np.mean(series.reference_x * dy - series.reference_y * dx)
    variance = (gradient_x**2 + gradient_y**2) * noise / 2 + gradient_heading**2 * heading
    return added, float(np.sqrt(variance / n))


def _time_offset(drive: RecordedDrive, anchor: PlanarPose) -> tuple[float, float]:
    """Lag of the drive behind the reference and its standard deviation, s.

    While the drive is straight, the unknown parameters hardly matter and a lag τ shows as a
    deviation of -τ v along the way: a regression on the reference's speed v, with a constant for
    the noise of the anchor. The standard deviation accounts for residuals correlated in time.
    """
    turned = np.flatnonzero(np.abs(drive.reference.heading - drive.reference.heading[0]) > STRAIGHT)
    end = drive.reference.time[turned[0]] if len(turned) else drive.duration
    path, reference = _residual(drive, anchor)
    straight = path.time <= end
    path, reference = path.part(straight), reference.part(straight)
    if len(path.time) < 10:
        return np.nan, np.nan
    c, s = np.cos(reference.heading), np.sin(reference.heading)
    along = c * (path.x - reference.x) + s * (path.y - reference.y)
    vx, vy = (
        CubicSpline(drive.reference.time, v)(path.time, 1)
        for v in (drive.reference.x, drive.reference.y)
    )
    speed = np.hypot(vx, vy)
    if np.ptp(speed) < 0.1:  # m/s; a lag does not show
        return np.nan, np.nan
    centred = speed - speed.mean()
    slope = float(centred @ along / (centred @ centred))
    rest = along - along.mean() - slope * centred
    variance = rest @ rest / (len(rest) - 2) / (centred @ centred)
    correlation = np.clip(rest[1:] @ rest[:-1] / max(rest @ rest, 1e-300), 0.0, 0.99)
    inflation = (1 + correlation) / (1 - correlation)  # of a first-order autoregressive noise
    return -slope, float(np.sqrt(variance * inflation))
