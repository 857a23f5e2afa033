"""Checks of measured drives before anything is estimated from them."""

import dataclasses
import math
from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from excitation_planner.design.prior import BoxPrior
from parameter_identification.drives.following import servo_angle
from parameter_identification.drives.measured import (
    MIN_SAMPLES,
    MeasuredDrive,
    Sensor,
    Signal,
    StartPose,
)
from parameter_identification.drives.proportion import contradiction, path_contradiction
from parameter_identification.estimation.model import DriveModel
from parameter_identification.estimation.noise import NoiseLevel
from parameter_identification.estimation.problem import LeastSquares, Loss
from parameter_identification.estimation.whiteness import resolution
from tricycle_core.errors import IdentificationError
from tricycle_core.quantities import FloatArray
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.batch import simulate

MIN_POSITIONS = 20
MIN_MOTION = 0.5  # m that a vehicle must have come from its start
SAME_VEHICLE = 2e-3  # m between a reference and the model that it was planned with
LONG = 5.0  # s, of a drive that is looked at by itself
LEAST_SLOPE = 0.5  # of what is measured, over what is expected, where a sign is wrong
UNIT = 5.0  # factor from which it is that of another unit
UNIT_OF_PATH = 2.5  # likewise, of positions
LEAST = {
    Sensor.HEADING: (math.inf, 0.05),
    Sensor.YAW_RATE: (0.4, 0.05),
    Sensor.LATERAL_ACCELERATION: (1.5, 0.1),
    Sensor.WHEEL_SPEED: (2.0, 0.3),
}
"""Least root mean square and standard deviation expected [SI] where signs and units are looked at.

Far above what a bias adds; the second without it.
"""
LEAST_STEERING = 0.1, 0.01  # rad, likewise
FORWARD = {Sensor.WHEEL_SPEED: "forward"}
"""Positive direction of a sensor; that of the others is to the left."""
RUN = 8  # positions that drives have in common where they are rounded
WIDER = 2.5  # factor by which the parameters of a plan may lie outside the ranges


def check_drives(
    drives: Sequence[MeasuredDrive], vehicle: Vehicle, *, other_vehicle: bool = False
) -> None:
    """Raise if nothing can be identified from one of the drives.

    Parameters
    ----------
    drives : sequence of MeasuredDrive
        All drives, also those that will only be predicted.
    vehicle : Vehicle
        Vehicle that should have driven.
    other_vehicle : bool
        Whether they may have been planned for another vehicle, as with an earlier file of this one.

    Raises
    ------
    IdentificationError
        If two are the same, the vehicle hardly moves, the drive was planned for another vehicle, or
        a sensor's axis points the other way.
    """
    same = same_drives([drive.signals[Sensor.POSITION].values for drive in drives])
    for later, earlier in same.items():
        a, b = drives[earlier].name, drives[later].name
        if a == b:
            raise IdentificationError(f"{a} is given twice")
        raise IdentificationError(f"{a} and {b} are the same drive")
    for drive in drives:
        check_motion(drive)
        if not other_vehicle:
            check_reference(drive, vehicle)
    check_signs(drives, vehicle)


def same_drives(positions: Sequence[FloatArray]) -> dict[int, int]:
    """Return which drives repeat an earlier one: most positions of the shorter are the other's too.

    Counted twice, a drive would make estimates look more certain than they are. Where positions are
    rounded, different drives of one maneuver have many in common: there, runs of them are compared.

    Parameters
    ----------
    positions : sequence of ndarray of float, shape (m, 2)
        Positions of each drive [m]; the numbers of drives are their places here.

    Returns
    -------
    earlier : dict of int to int
        By the number of a drive, that of the first one which it repeats and which repeats none.
    """
    n = len(positions)
    if n < 2:
        return {}
    rounded = any(resolution(column) > 0.0 for one in positions for column in one.T)
    points = [np.unique(_keys(one, RUN if rounded else 1)) for one in positions]
    sizes = np.array([len(one) for one in points])
    every, owner = np.concatenate(points), np.repeat(np.arange(n), sizes)
    order = np.argsort(every, kind="stable")
    every, owner = every[order], owner[order]
    repeated = np.flatnonzero(every[1:] == every[:-1])
    several = np.union1d(repeated, repeated + 1)
    every, owner = every[several], owner[several]
    pairs = [np.empty(0, dtype=np.intp)]
    for apart in range(1, n):
        same = every[apart:] == every[:-apart]
        if not same.any():
            break
        pairs.append(owner[apart:][same] * n + owner[:-apart][same])
    both, shared = np.unique(np.concatenate(pairs), return_counts=True)
    alike = both[2 * shared > np.minimum(sizes[both // n], sizes[both % n])]
    found: dict[int, int] = {}
    for later, earlier in zip((alike // n).tolist(), (alike % n).tolist(), strict=True):
        if later not in found and earlier not in found:
            found[later] = earlier
    return found


def _keys(positions: FloatArray, run: int) -> NDArray[np.uint64]:
    """A number for each run of so many positions (m, 2) that differ from one to the next."""
    x, y = np.ascontiguousarray(positions.T + 0.0).view(np.uint64)  # no -0
    keys = _scattered(_scattered(x) + y)
    keys = np.append(keys[:1], keys[1:][keys[1:] != keys[:-1]])
    runs = keys[: max(len(keys) - run + 1, 0)]
    for later in range(1, run):
        runs = _scattered(runs) + keys[later : len(runs) + later]
    return runs


def _scattered(numbers: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Different numbers for different ones; each of their bits depends on all (SplitMix64)."""
    for shift, factor in ((30, 0xBF58476D1CE4E5B9), (27, 0x94D049BB133111EB)):
        numbers = (numbers ^ (numbers >> np.uint64(shift))) * np.uint64(factor)
    return numbers ^ (numbers >> np.uint64(31))


def check_motion(drive: MeasuredDrive) -> None:
    """Raise if the vehicle hardly moves.

    Parameters
    ----------
    drive : MeasuredDrive
        Drive to check.

    Raises
    ------
    IdentificationError
        If there are fewer than `MIN_POSITIONS`, or none is `MIN_MOTION` away from the start.
    """
    position = drive.signals[Sensor.POSITION].values
    if len(position) < MIN_POSITIONS:
        raise IdentificationError(f"{drive.name}: {len(position)} positions are too few")
    start = np.median(position[: min(10, len(position) // 2)], axis=0)
    reach = float(np.quantile(np.hypot(*(position - start).T), 0.98))
    if reach < MIN_MOTION:
        raise IdentificationError(
            f"{drive.name}: the vehicle comes {reach:.2f} m from its start: too little motion to "
            f"identify anything, {MIN_MOTION} m are needed"
        )


def check_reference(drive: MeasuredDrive, vehicle: Vehicle) -> None:
    """Raise if no parameters of the vehicle give the trajectory that the drive was planned with.

    They may lie outside the ranges: a vehicle file may be better known than when it was planned.

    Parameters
    ----------
    drive : MeasuredDrive
        Drive whose reference is compared; without a reference, nothing is checked.
    vehicle : Vehicle
        Vehicle that should have driven.

    Raises
    ------
    IdentificationError
        If the closest trajectory is more than `SAME_VEHICLE` (rms) away from the reference.
    """
    reference = drive.reference
    if reference is None or not vehicle.unknown:
        return
    motion = simulate(vehicle, drive.commands, threads=1)
    nominal = (np.interp(reference.time, motion.time, row[0]) for row in (motion.x, motion.y))
    position = np.column_stack([reference.x, reference.y])
    if np.hypot(*(position - np.column_stack(list(nominal))).T).max() < SAME_VEHICLE:
        return
    planned = MeasuredDrive(
        drive.name,
        drive.commands,
        {Sensor.POSITION: Signal(reference.time, position)},
        start=StartPose(0.0, 0.0, 0.0, position_std=1e-6, heading_std=1e-6),
    )
    wide = {name: _wider(vehicle, name) for name in vehicle.unknown}
    any_such = dataclasses.replace(vehicle, unknown=wide)
    prior = BoxPrior.uniform(len(wide))
    models = [DriveModel(any_such, planned)]
    with LeastSquares(models, prior.mean, prior.information, Loss.SQUARED) as problem:
        problem.noise = {Sensor.POSITION: NoiseLevel(0.1 * SAME_VEHICLE)}
        fits = [problem.minimise(start) for start in problem.candidates(6, seed=0)]
        ((predicted,),) = problem.predictions(min(fits, key=lambda fit: fit.cost).at)
    if predicted.rms > SAME_VEHICLE:
        raise IdentificationError(
            f"{drive.name}: planned for another vehicle: whatever its unknown parameters, "
            f"{vehicle.name} comes no closer than {predicted.rms:.2g} m (rms) to the plan's "
            "reference; give the file that it was planned with; a corrected one with "
            "--other-vehicle (other_vehicle=True)"
        )


def check_signs(drives: Sequence[MeasuredDrive], vehicle: Vehicle) -> None:
    """Raise if a sensor has the wrong sign or unit, judged by the motion that the commands give.

    Its axis points the other way, or that of the commands does, or its unit is another one;
    estimates that follow such a sensor are wrong. So it is with positions in a mirrored frame.
    Windows of a recording are too short to be looked at one by one.

    Parameters
    ----------
    drives : sequence of MeasuredDrive
        Drives to check.
    vehicle : Vehicle
        Vehicle that should have driven; its nominal values are used.

    Raises
    ------
    IdentificationError
        Naming the drive, the sensor, and what is right (REP-103).
    """
    from scipy.signal import detrend  # takes as long as NumPy

    short = [drive for drive in drives if np.ptp(drive.signals[Sensor.POSITION].time) < LONG]
    long = [drive for drive in drives if drive not in short]
    for together in (*([drive] for drive in long), short):
        pairs: dict[Sensor, list[FloatArray]] = {}
        for drive in together:
            for sensor, pair in _expected_and_measured(drive, vehicle):
                pairs.setdefault(sensor, []).append(pair)
        for sensor, found in pairs.items():
            varying = [detrend(pair, type="constant") for pair in found]
            if sensor is Sensor.HEADING:  # an error of the steering's zero is a steady rise
                varying = [detrend(pair, type="linear") for pair in found]
            what = f"{together[0].name}: the {sensor.value}"
            positive = f"{FORWARD.get(sensor, 'to the left')} (REP-103), in {sensor.unit}"
            for parts, least in zip((found, varying), LEAST[sensor], strict=True):
                _check_alike(np.hstack(parts), least, what, positive)
        for drive in together:
            if (angle := drive.steering_angle) is not None:
                expected = servo_angle(drive.commands, angle.time, vehicle)
                pair, what = np.stack([expected, angle.values]), f"{drive.name}: the steering angle"
                _check_alike(pair, LEAST_STEERING[0], what, "to the left, in rad")
                varying = detrend(pair, type="constant")
                _check_alike(varying, LEAST_STEERING[1], what, "to the left, in rad")
    for drive in long:
        _check_path(drive, vehicle)


def _check_path(drive: MeasuredDrive, vehicle: Vehicle) -> None:
    """Raise if the positions are those of a mirrored frame, or in another unit."""
    at = drive.start.speed
    motion = simulate(vehicle, drive.commands, speed=at, setpoint=at, threads=1)
    signal = drive.signals[Sensor.POSITION].between(0.0, float(motion.time[-1]))
    if len(signal.time) < MIN_SAMPLES:
        return
    expected = (np.interp(signal.time, motion.time, row[0]) for row in (motion.x, motion.y))
    steering = servo_angle(drive.commands, signal.time, vehicle)
    if problem := path_contradiction(
        signal.values,
        np.column_stack([*expected]),
        factor=UNIT_OF_PATH,
        turns=float(np.sqrt(np.mean(steering**2))) > LEAST_STEERING[0],
    ):
        raise IdentificationError(
            f"{drive.name}: the positions {problem} what the commands give: they must be in m, in "
            "a frame of which y is to the left of x (REP-103), and the commands positive to the "
            "left; mend what is wrong"
        )


def _check_alike(pair: FloatArray, least: float, what: str, positive: str) -> None:
    """Raise if samples cannot be of the expected ones, which precede them (2, m)."""
    expected, measured = pair
    if problem := contradiction(
        measured, expected, least=least, factor=UNIT, least_slope=LEAST_SLOPE
    ):
        if not measured.any():
            raise IdentificationError(
                f"{what} {problem} what the commands give: if nothing measures it, leave out its "
                "topic (tricycle bag convert --exclude TOPIC), or its column of a table"
            )
        raise IdentificationError(
            f"{what} {problem} what the commands give: it must be positive {positive}, and so must "
            "be the commands; mend the sign or unit that is wrong"
        )


def _expected_and_measured(
    drive: MeasuredDrive, vehicle: Vehicle
) -> Iterator[tuple[Sensor, FloatArray]]:
    """Samples (2, m) of the sensors of `LEAST`."""
    at = drive.start.speed
    motion = simulate(vehicle, drive.commands, speed=at, setpoint=at, threads=1)
    seen = (motion.yaw, motion.yaw_rate, motion.lateral_acceleration, motion.drive_speed)
    for sensor, (row,) in zip(LEAST, seen, strict=True):
        if sensor in drive.signals:
            signal = drive.signals[sensor].between(0.0, float(motion.time[-1]))
            if len(signal.time) >= MIN_SAMPLES:
                expected = np.interp(signal.time, motion.time, row)
                yield sensor, np.stack([expected, signal.values[:, 0]])


def _wider(vehicle: Vehicle, name: str) -> tuple[float, float]:
    """Return a range of an unknown parameter that is wider, within what any vehicle may have."""
    low, high = vehicle.unknown[name]
    least, most = vehicle.bounds(name)
    low = low / WIDER if low > 0.0 else max(least, low * WIDER)
    return low, min(most, high * WIDER if high > 0.0 else high / WIDER)
