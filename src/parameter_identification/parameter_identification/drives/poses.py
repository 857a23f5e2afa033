"""Measured poses, from messages of several types to planar poses over time."""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tricycle_core.errors import JudgeError
from tricycle_core.frames import of_frame
from tricycle_core.quantities import FloatArray
from tricycle_core.rotations import is_unit, yaw_of
from tricycle_core.stamps import nanoseconds_of

NO_FIX = -1  # sensor_msgs/NavSatStatus


@dataclass(frozen=True)
class Datum:
    """Geodetic origin of local east-north coordinates, WGS84.

    Attributes
    ----------
    latitude, longitude : float
        Degrees.
    altitude : float
        Above the ellipsoid [m].
    """

    latitude: float
    longitude: float
    altitude: float = 0.0

    def __post_init__(self) -> None:
        if not (abs(self.latitude) <= 90 and abs(self.longitude) <= 180):
            raise JudgeError(
                f"datum {self.latitude}, {self.longitude}: latitude is -90 to 90 degrees, "
                "longitude -180 to 180"
            )


@dataclass(frozen=True, eq=False)
class PlanarTrajectory:
    """Planar poses over time.

    Attributes
    ----------
    time : ndarray of float, shape (t,)
        Times since the start event [s], strictly increasing.
    x, y : ndarray of float, shape (t,)
        Position [m].
    heading : ndarray of float, shape (t,)
        Left positive, continuous [rad]; NaN where the sensor has none.
    """

    time: FloatArray
    x: FloatArray
    y: FloatArray
    heading: FloatArray

    def part(self, selected: NDArray[np.bool_]) -> "PlanarTrajectory":
        """Return the poses where ``selected`` (t,) is true."""
        return PlanarTrajectory(*(v[selected] for v in (self.time, self.x, self.y, self.heading)))


class PoseCollector:
    """Collects the poses of a topic, whatever its type.

    Parameters
    ----------
    bag : Path
        For messages.
    topic : str
        Name in the bag.
    type_name : str
        ROS type of its messages.
    child_frame : str
        Frame of the poses and transforms to take; messages that name no frame are taken too.
    datum : Datum, optional
        Origin for NavSatFix.

    Raises
    ------
    JudgeError
        If messages of that type hold no pose, or the datum is missing or of no use.
    """

    def __init__(
        self, bag: Path, topic: str, type_name: str, child_frame: str, datum: Datum | None
    ) -> None:
        self._where = f"{bag}: {topic}"
        readers: dict[str, Callable[[Any], Iterable[tuple[int, float, float, float]]]] = {
            "nav_msgs/msg/Odometry": lambda m: self._of_child_frame(m, m.pose.pose),
            "geometry_msgs/msg/PoseStamped": lambda m: [(stamp_of(m), *planar(m.pose))],
            "geometry_msgs/msg/TransformStamped": lambda m: self._of_child_frame(m, m.transform),
            "tf2_msgs/msg/TFMessage": lambda m: chain.from_iterable(
                self._of_child_frame(transform, transform.transform) for transform in m.transforms
            ),
            "sensor_msgs/msg/NavSatFix": self._of_satellites,
        }
        if type_name not in readers:
            raise JudgeError(
                f"{self._where} is {type_name}: poses are read from {', '.join(sorted(readers))}"
            )
        self._read = readers[type_name]
        self._rows: list[tuple[int, float, float, float]] = []
        self._child_frame = child_frame
        self._other_frames: set[str] = set()
        self._datum = datum
        if type_name.endswith("NavSatFix") and datum is None:
            raise JudgeError(f"{self._where} is NavSatFix: give the datum of the local coordinates")
        if datum is not None and not type_name.endswith("NavSatFix"):
            raise JudgeError(
                f"{self._where} is {type_name}: a datum is only for NavSatFix: leave it out, or "
                "name the topic of the satellites' fixes"
            )

    def add(self, message: Any) -> None:
        """Take the poses of the next message."""
        self._rows += self._read(message)

    def since(self, start: int) -> PlanarTrajectory:
        """Return all poses, timed from the start event.

        Parameters
        ----------
        start : int
            Stamp of the start event [ns].

        Raises
        ------
        JudgeError
            If there are none, stamps jump back, or a pose is not a number.
        """
        if not self._rows and self._other_frames:
            raise JudgeError(
                f"{self._where} holds no poses of {self._child_frame}; it holds those of "
                f"{', '.join(sorted(self._other_frames))}: name the one to take (--child-frame)"
            )
        if not self._rows:
            raise JudgeError(f"{self._where} holds no poses")
        stamps = np.array([row[0] for row in self._rows], dtype=np.int64)
        if not stamps.any():
            raise JudgeError(f"{self._where}: all stamps are 0: the poses have no time")
        back = np.flatnonzero(np.diff(stamps) < 0)
        if len(back):
            at = back[0]
            raise JudgeError(
                f"{self._where}: the clock jumps back by "
                f"{(stamps[at] - stamps[at + 1]) * 1e-9:.3f} s "
                f"at {(stamps[at] - start) * 1e-9:.3f} s"
            )
        new = np.concatenate([[True], np.diff(stamps) > 0])  # a pose sent twice counts once
        values = np.array([row[1:] for row in self._rows])[new]
        time = (stamps[new] - start) * 1e-9
        wrong = ~np.isfinite(values[:, :2]).all(axis=1)
        if not np.isnan(values[:, 2]).all():  # a sensor has headings, or it has none
            wrong |= np.isnan(values[:, 2])
        if wrong.any():
            raise JudgeError(
                f"{self._where}: the pose at {time[wrong][0]:.3f} s is not a number, or its "
                "orientation no unit quaternion "
                f"({np.count_nonzero(wrong)} of {len(time)} poses)"
            )
        return PlanarTrajectory(time, values[:, 0], values[:, 1], np.unwrap(values[:, 2]))

    def _of_child_frame(self, message: Any, pose: Any) -> Iterator[tuple[int, float, float, float]]:
        if of_frame(message.child_frame_id, self._child_frame):
            yield stamp_of(message), *planar(pose)
        else:
            self._other_frames.add(message.child_frame_id.lstrip("/"))

    def _of_satellites(self, message: Any) -> Iterator[tuple[int, float, float, float]]:
        if self._datum is None:
            raise JudgeError("positions of satellites need a datum")
        if message.status.status != NO_FIX:
            at = message.latitude, message.longitude, message.altitude
            yield stamp_of(message), *east_north(*at, self._datum), math.nan


def stamp_of(message: Any) -> int:
    """Return the stamp of a message's header [ns].

    Parameters
    ----------
    message : ROS message
        Message that has a header.
    """
    return nanoseconds_of(message.header.stamp)


def planar(pose: Any) -> tuple[float, float, float]:
    """Return x [m], y [m] and heading [rad]; the heading is NaN where its quaternion is none.

    Parameters
    ----------
    pose : geometry_msgs Pose or Transform
        In any frame whose z axis points up.
    """
    position, q = (
        (pose.position, pose.orientation)
        if hasattr(pose, "position")
        else (pose.translation, pose.rotation)
    )
    if not is_unit(q):
        return position.x, position.y, math.nan
    return position.x, position.y, yaw_of(q)


def east_north(
    latitude: float, longitude: float, altitude: float, datum: Datum
) -> tuple[float, float]:
    """Return the position east and north of a datum [m], in its tangent plane (WGS84).

    Parameters
    ----------
    latitude, longitude : float
        Degrees.
    altitude : float
        Above the ellipsoid [m].
    datum : Datum
        Origin.

    Examples
    --------
    One degree of longitude at the equator:

    >>> east, north = east_north(0.0, 1.0, 0.0, Datum(0.0, 0.0))
    >>> round(east), round(north)
    (111314, 0)
    """
    point = _earth_centred(latitude, longitude, altitude)
    origin = _earth_centred(datum.latitude, datum.longitude, datum.altitude)
    dx, dy, dz = (a - b for a, b in zip(point, origin, strict=True))
    phi, lam = math.radians(datum.latitude), math.radians(datum.longitude)
    east = -math.sin(lam) * dx + math.cos(lam) * dy
    north = -math.sin(phi) * (math.cos(lam) * dx + math.sin(lam) * dy) + math.cos(phi) * dz
    return east, north


def _earth_centred(latitude: float, longitude: float, altitude: float) -> tuple[float, ...]:
    a, e2 = 6_378_137.0, 6.694_379_990_14e-3  # WGS84: semi-major axis in m, eccentricity squared
    phi, lam = math.radians(latitude), math.radians(longitude)
    normal = a / math.sqrt(1 - e2 * math.sin(phi) ** 2)
    return (
        (normal + altitude) * math.cos(phi) * math.cos(lam),
        (normal + altitude) * math.cos(phi) * math.sin(lam),
        (normal * (1 - e2) + altitude) * math.sin(phi),
    )
