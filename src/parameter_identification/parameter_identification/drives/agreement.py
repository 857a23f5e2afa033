"""Checks of a recording's columns against its poses: swapped columns, wrong units, signs, places.

No simulation of the vehicle is asked, so that slow drives and gentle turns tell it too.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from parameter_identification.drives.motion import SLOWEST, TURNED, Motion
from parameter_identification.drives.proportion import contradiction
from parameter_identification.drives.table import Recording
from tricycle_core.errors import IdentificationError
from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.wheels import AXLES

STEP = 0.2  # s of way that shows a course
FASTEST = 30.0  # m/s over a step, beyond which the pose jumped
ALONG = 0.5  # least mean cosine of twice the angle between course and heading: 30 degrees
FACTOR = 2.0  # that is one of units; slip, roll and understeer explain less
STEERING_FACTOR = 5.0  # likewise; a map may be a guess
ENOUGH = 100  # ticks
LEAST_TURN = 0.1  # rad/s (rms), far above the noise of a heading's change
LEAST_LATERAL = 0.5  # m/s^2 (rms)
LEAST_STEERING = 0.1  # rad (rms), above the error of a steering's zero
TURN_STEP = 0.5  # s of way that shows about which point the vehicle turns
LEAST_CHANGE = 0.05  # rad (rms) by which the turns of such ways differ
SLIPPING = 0.05  # of the wheelbase, by which the slip of the rear tyres may move that point
MISPLACED = 0.3  # of the wheelbase, from which poses are those of another point


def check_agreement(
    recording: Recording,
    motion: Motion,
    vehicle: Vehicle,
    steering: FloatArray,
    turned: FloatArray,
) -> None:
    """Raise if a column contradicts the poses.

    Parameters
    ----------
    recording : Recording
        Recording to check.
    motion : Motion
        Motion of the recording: its poses, smoothed, on ticks.
    vehicle : Vehicle
        Vehicle that drove; the radius of its tyres is used.
    steering : ndarray of float, shape (t,)
        Angle of the steering motor at the ticks, commanded or measured [rad].
    turned : ndarray of float, shape (t,)
        Angle of the steering motor by which the vehicle turns as the poses do [rad].

    Raises
    ------
    IdentificationError
        Naming the entry, and what may be wrong with it.
    """
    _check_way(recording.name, motion, headed=recording.yaw is not None)
    if recording.yaw is not None:
        _check_place(recording.name, motion, vehicle)
    moving = np.abs(motion.speed) > SLOWEST
    moving &= np.abs(motion.speed) < FASTEST
    for name, given, expected, least in _pairs(recording, motion, vehicle):
        if problem := _contradiction_of(given[moving], expected[moving], least):
            raise IdentificationError(
                f"{recording.name}: {name} {problem} what the poses give: mend its unit or sign in "
                "the mapping, or theirs"
            )
    ahead = moving & (motion.speed > 0.0)
    given, expected = steering[ahead], turned[ahead]
    if problem := _contradiction_of(given, expected, LEAST_STEERING, STEERING_FACTOR):
        raise IdentificationError(
            f"{recording.name}: steering {problem} what the turns of the poses need: positive is "
            "to the left; mend its unit in the mapping, or the gain of steering_map"
        )
    if np.count_nonzero(ahead) < ENOUGH:
        return
    steered, needed = (float(np.sqrt(np.mean(angles**2))) for angles in (given, expected))
    if steered > STEERING_FACTOR * LEAST_STEERING and needed < LEAST_STEERING:
        raise IdentificationError(
            f"{recording.name}: steering is {steered:.2g} rad (rms), but the poses drive straight "
            f"on ({needed:.1g} rad): do x and y have the same unit? Mend theirs in the mapping, "
            "the unit of the steering, or the gain of steering_map"
        )


def _check_way(name: str, motion: Motion, *, headed: bool) -> None:
    step = round(STEP / TICK)
    way_x, way_y = (v[step:] - v[:-step] for v in (motion.x, motion.y))
    way = np.hypot(way_x, way_y)
    moved = way > SLOWEST * STEP
    if np.count_nonzero(moved) < ENOUGH:
        return
    usual = float(np.median(way[moved])) / STEP
    if usual > FASTEST:
        raise IdentificationError(
            f"{name}: the poses move at {usual:.3g} m/s: mend the unit of x and y, or of time, in "
            "the mapping"
        )
    moved &= way < FASTEST * STEP
    if not headed or np.count_nonzero(moved) < ENOUGH:
        return
    apart = (np.arctan2(way_y, way_x) - motion.yaw[step // 2 :][: len(way)])[moved]
    if np.mean(np.cos(2.0 * apart)) < ALONG:  # forward or backward
        raise IdentificationError(
            f"{name}: the vehicle does not move the way that yaw points: are x and y swapped, is "
            "the unit of yaw another one, or is it not counted from the axis of x to the left?"
        )


def _check_place(name: str, motion: Motion, vehicle: Vehicle) -> None:
    """Raise if the poses are not those of the COM, by how far they move aside in turns.

    The COM turns about the rear axle, but for the slip of its tyres. A heading that is off by the
    same angle everywhere moves aside without turns too, and is let through.
    """
    step = round(TURN_STEP / TICK)
    turn = motion.yaw[step:] - motion.yaw[:-step]
    middle = slice(step // 2, step // 2 + len(turn))
    speed, yaw = motion.speed[middle], motion.yaw[middle]
    way_x, way_y = (v[step:] - v[:-step] for v in (motion.x, motion.y))
    front, rear = (abs(vehicle.axle_x(axle)) for axle in AXLES)
    load = vehicle.mass * front / vehicle.wheelbase
    slip = load * speed**2 / vehicle.axle_stiffness()["rear"]  # m, ahead of the axle
    shows = (speed > SLOWEST) & (slip < SLIPPING * vehicle.wheelbase)
    shows &= np.hypot(way_x, way_y) < FASTEST * TURN_STEP
    jumps = np.cumsum(np.abs(motion.turned) > TURNED)
    shows &= jumps[step:] == jumps[:-step]
    if np.count_nonzero(shows) < ENOUGH:
        return
    along = (np.cos(yaw) * way_x + np.sin(yaw) * way_y)[shows]
    aside = (np.cos(yaw) * way_y - np.sin(yaw) * way_x + slip * turn)[shows]
    turn = turn[shows]
    change, rest = (v - along * (v @ along) / (along @ along) for v in (turn, aside))
    energy = float(change @ change)
    if energy < LEAST_CHANGE**2 * len(change):
        return
    behind = float(change @ rest) / energy
    # ways that overlap err alike
    std = float(np.sqrt(np.mean((rest - behind * change) ** 2) * step / energy))
    if abs(behind - rear) > MISPLACED * vehicle.wheelbase + 3.0 * std:
        raise IdentificationError(
            f"{name}: the poses turn about a point {behind:.2g} m behind them; the centre of mass "
            f"turns about the rear axle, {rear:.2g} m behind it: are they those of a point "
            f"{behind - rear:+.2g} m farther ahead than the mapping says (its `sensor`)? Or is yaw "
            "the direction of the motion, not that of the body? Then leave it out"
        )


def _pairs(
    recording: Recording, motion: Motion, vehicle: Vehicle
) -> Iterator[tuple[str, FloatArray, FloatArray, float]]:
    """Name of an entry, its values on ticks, those by the poses, and the least that is checked."""
    rolling = motion.speed / vehicle.driven_radius
    expected = {
        "yaw_rate": (motion.yaw_rate, LEAST_TURN),
        "wheel_speed": (rolling, SLOWEST / vehicle.driven_radius),
        "acceleration_y": (motion.speed * motion.yaw_rate, LEAST_LATERAL),
    }
    for name, (values, least) in expected.items():
        if name in recording.more:
            yield name, recording.more[name].at(motion.time), values, least
    for wheel in vehicle.wheels:
        name = f"wheel_speeds.{wheel.name}"
        if name in recording.more:
            radius = float(vehicle.of(wheel).tyre_radius)
            given = recording.more[name].at(motion.time)
            yield name, given, motion.speed / radius, SLOWEST / radius


def _contradiction_of(
    given: FloatArray, expected: FloatArray, least: float, factor: float = FACTOR
) -> str:
    """As `contradiction`, of the values that are there; nothing if these are few."""
    there: NDArray[np.bool_] = np.isfinite(given) & np.isfinite(expected)
    if np.count_nonzero(there) < ENOUGH:
        return ""
    return contradiction(given[there], expected[there], least=least, factor=factor)
