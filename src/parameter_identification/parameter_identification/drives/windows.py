"""Drives out of a long recording that has no plan: windows, each with its own start state.

A window begins while the vehicle moves. The model therefore drives a run-in before it, with the
commands of that time, so that steering, tyres and yaw rate are those of the moment when the window
begins. Where the recording has no speed command, the model is given set-points with which its
nominal vehicle has the speed of the measured pose.
"""

import dataclasses
import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from parameter_identification.drives.agreement import check_agreement
from parameter_identification.drives.following import (
    curvature_per_angle,
    servo_response,
    speed_followed,
    steering_setpoints,
)
from parameter_identification.drives.measured import (
    STAMP_JITTER,
    STEERING_LATE,
    MeasuredDrive,
    Sensor,
    Signal,
    StartPose,
    of_wheels,
    usable,
)
from parameter_identification.drives.motion import SLOWEST, TURNED, Motion, motion_of
from parameter_identification.drives.samples import MAX_GAP
from parameter_identification.drives.smoothing import LEAST, smooth
from parameter_identification.drives.table import (
    Columns,
    EstimatedMap,
    Recording,
    SteeringMap,
    read_recording,
)
from tricycle_bridge.protocol.limits import MAX_SPEED, STEERING_END_STOP
from tricycle_core.errors import IdentificationError
from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.kernel import functions_for
from tricycle_sim.vehicle.parts import steering_constants
from tricycle_sim.vehicle.wheels import AXLES

APPROACH, TURN_IN = 1.2, 0.8  # s before the run-in at its first speed; until it is steered alike
RUN_IN = 2.0  # s before a window: some time constants of servo and tyres
SETTLED = 6.0  # integral times of a speed loop before it, where the set-points are recorded
SPARSE = 2.5  # periods of steering angles and set-points, that may be beyond the longest gap
MISSED, LEAST_MISSED = 4.0, 1e-3  # medians, and m: where the speed changes as nowhere else
JUMP = 50.0  # m/s^2 that no vehicle reaches: the pose jumped
QUIET = 1.0  # m/s^2 of lateral acceleration up to which the tyres hardly slip
PART, PARTS = 2.0, 4  # s of turns whose errors are alike, and the fewest parts of a recording
UNCERTAIN = 0.1  # of the gain of a steering map, by which parts of the turns may change it
FAR_OFF = 0.5  # of the usual speed, by which set-points may differ from it
MEASURED = {
    "yaw_rate": Sensor.YAW_RATE,
    "wheel_speed": Sensor.WHEEL_SPEED,
    "acceleration_y": Sensor.LATERAL_ACCELERATION,
    "motor_torque": Sensor.MOTOR_TORQUE,
}
"""Sensor by the entry of a mapping that tells where a table has it."""


@dataclass(frozen=True)
class Windows:
    """Choice of the windows of a recording.

    Attributes
    ----------
    length : float
        Duration of a window [s].
    every : float
        Grid of their beginnings [s].
    above : float
        Speed that the vehicle has at a beginning [m/s].
    overlapping : bool
        Windows for predictions, which may share samples and end at rest. An identification counts a
        sample once, and needs motion: its windows are faster than `above` all through.

    Raises
    ------
    IdentificationError
        If a number is not positive.
    """

    length: float = 2.0
    every: float = 0.5
    above: float = 0.4
    overlapping: bool = False

    def __post_init__(self) -> None:
        if not (0 < self.length < math.inf and 0 < self.every < math.inf and self.above > 0):
            raise IdentificationError("windows: length, every and above must be positive")


@dataclass(frozen=True)
class Selection:
    """Windows of a recording that are used, and how many are not.

    Attributes
    ----------
    drives : tuple of MeasuredDrive
        Windows that are used, one drive each.
    left_out : mapping of str to int
        By reason, how many windows were left out of those that could begin on the grid, outside of
        those that are used.
    run_in : float
        Time before a window in which the model is driven too [s]: what is wrong there counts as in
        the window.
    """

    drives: tuple[MeasuredDrive, ...]
    left_out: Mapping[str, int]
    run_in: float = RUN_IN

    def __str__(self) -> str:
        reasons = (f"{number} {reason}" for reason, number in self.left_out.items())
        return ", ".join(reasons) or "none"


def estimate_map(recording: Recording, vehicle: Vehicle) -> EstimatedMap:
    """Return gain and offset of the steering command, from turns of little lateral acceleration.

    Parameters
    ----------
    recording : Recording
        Recording in which the steering command varies.
    vehicle : Vehicle
        Vehicle that drove; its wheelbase, tyres and servo are used.

    Raises
    ------
    IdentificationError
        If the recording has too few such turns, or the command hardly varies in them.
    """
    motion = motion_of(recording)
    slow = _quiet(recording, motion)
    command = _followed(recording, _steering(recording, motion), vehicle)[slow]
    if np.ptp(command) < 1e-9:
        raise IdentificationError(
            f"{recording.name}: the steering command is always the same: give the map's gain"
        )
    angle = turned_angle(motion, vehicle)[slow]
    weights = np.ones(len(angle))
    for _ in range(20):  # absolute errors instead of squared ones: poses jump
        gain, offset = np.polyfit(command, angle, 1, w=weights)
        error = np.abs(angle - gain * command - offset)
        weights = 1.0 / np.sqrt(np.maximum(error, np.median(error)) + 1e-9)
    std = _std_of_gain(command, angle, weights)
    if not std < UNCERTAIN * abs(gain):
        low, high = np.quantile(command, (0.25, 0.75))
        raise IdentificationError(
            f"{recording.name}: steering_map: the turns do not show the gain, which would be "
            f"{gain:.2g} ± {std:.2g}: the command hardly varies (half of the time it is "
            f"from {low:.3g} to {high:.3g}): give gain and offset, or record turns to both sides"
        )
    return EstimatedMap(gain=float(gain), offset=float(offset))


def _std_of_gain(command: FloatArray, angle: FloatArray, weights: FloatArray) -> float:
    """Standard deviation of the slope of a line, by how it changes without parts of the samples.

    Errors of samples that follow each other are alike: their scatter tells less than the parts do.
    """
    parts = max(PARTS, round(len(command) * TICK / PART))
    part = np.arange(len(command)) * parts // len(command)
    c, a = command - command.mean(), angle - angle.mean()
    moments = np.array(
        [np.bincount(part, weights**2 * of) for of in (np.ones_like(c), c, a, c * c, c * a)]
    )
    one, c1, a1, cc, ca = moments.sum(axis=1, keepdims=True) - moments  # without each part
    spread = one * cc - c1**2
    if not np.all(spread > 0.0):
        return math.inf
    gains = (one * ca - c1 * a1) / spread
    return math.sqrt((parts - 1.0) * float(np.var(gains)))


def steering_of(recording: Recording, vehicle: Vehicle, columns: Columns) -> SteeringMap:
    """Return the map of a mapping, estimated from the recording where that is asked for.

    Parameters
    ----------
    recording : Recording
        Read by the mapping.
    vehicle : Vehicle
        Vehicle that drove.
    columns : Columns
        The mapping.

    Raises
    ------
    IdentificationError
        If it cannot be estimated.
    """
    if isinstance(columns.steering_map, SteeringMap):
        return columns.steering_map
    return estimate_map(recording, vehicle)


def turned_angle(motion: Motion, vehicle: Vehicle) -> FloatArray:
    """Return the angle of the steering motor that a steady turn shows, at each tick [rad].

    Wheels that point along the path, and what the tyres add (understeer gradient).

    Parameters
    ----------
    motion : Motion
        Motion that was driven.
    vehicle : Vehicle
        Vehicle that drove; its linkage, tyres and wheelbase are used.
    """
    stiffness = vehicle.axle_stiffness()
    front, rear = (stiffness[axle] * abs(vehicle.axle_x(axle)) for axle in AXLES)
    gradient = vehicle.mass / vehicle.wheelbase * (rear - front)
    gradient /= stiffness["front"] * stiffness["rear"]
    speed = np.maximum(motion.speed, SLOWEST)
    rolling = np.arctan(vehicle.wheelbase * motion.yaw_rate / speed)
    constants, road_angle = steering_constants(vehicle, TICK), functions_for(vehicle).road_angle
    motor = np.linspace(-vehicle.steering_limit, vehicle.steering_limit, 201)
    road = [road_angle(angle, constants) for angle in motor]
    return np.interp(rolling + gradient * speed * motion.yaw_rate, road, motor)


def _quiet(recording: Recording, motion: Motion) -> NDArray[np.bool_]:
    """Ticks at which the vehicle moves with little lateral acceleration."""
    quiet: NDArray[np.bool_] = motion.speed > SLOWEST
    quiet &= np.abs(motion.speed * motion.yaw_rate) < QUIET
    if np.count_nonzero(quiet) < 2.0 / TICK:
        raise IdentificationError(
            f"{recording.name}: the steering map cannot be estimated: less than 2 s at more than "
            f"{SLOWEST:g} m/s with a lateral acceleration below {QUIET:g} m/s^2: give it; or "
            f"{_question_of_units(recording, motion)}"
        )
    return quiet


def _question_of_units(recording: Recording, motion: Motion) -> str:
    """Question for the end of an error, with what shows the answer."""
    return (
        "are the units wrong? In the mean, "
        f"the poses come every {np.mean(np.diff(recording.time)):.3g} s and move at "
        f"{np.mean(np.abs(motion.speed)):.3g} m/s"
    )


def _steering(recording: Recording, motion: Motion) -> FloatArray:
    """Steering of the table (t,) at the ticks: set-points hold, angles change evenly."""
    return recording.steering.at(motion.time, held=not recording.steering_measured)


def _followed(recording: Recording, steering: FloatArray, vehicle: Vehicle) -> FloatArray:
    """Angles (t,) of the steering motor, of angles or commands as the table has them."""
    return steering if recording.steering_measured else servo_response(steering, vehicle)


def setpoints_of(
    recording: Recording, motion: Motion, vehicle: Vehicle, steering: SteeringMap
) -> tuple[FloatArray, float]:
    """Return set-points (t,) of the steering: those recorded, or those that give the angle [rad].

    With the standard deviation of the curvature that they give [1/m].

    Parameters
    ----------
    recording : Recording
        From `read_recording`.
    motion : Motion
        Motion of that recording.
    vehicle : Vehicle
        Vehicle that drove; its servo is used.
    steering : SteeringMap
        From the recording's steering to the angle of the steering motor.

    Raises
    ------
    IdentificationError
        If there are too few angles.
    """
    if not recording.steering_measured:
        return steering.angle(_steering(recording, motion)), 0.0
    time, measured = recording.steering.time, recording.steering.values
    if len(time) < LEAST:
        raise IdentificationError(
            f"{recording.name}: {len(time)} steering angles: at least {LEAST} are needed"
        )
    angles = smooth(time, steering.angle(measured)[:, np.newaxis])
    angle = angles.spline(np.clip(motion.time, time[0], time[-1]))[:, 0]
    wanted = steering_setpoints(angle, vehicle)
    # the set-point that leads to an angle near the stop may lie beyond it
    within = np.abs(angle) <= STEERING_END_STOP
    wanted[within] = np.clip(wanted[within], -STEERING_END_STOP, STEERING_END_STOP)
    return wanted, angles.value_std * abs(curvature_per_angle(vehicle))


def read_windows(
    path: Path | str, vehicle: Vehicle, columns: Columns, windows: Windows | None = None
) -> list[MeasuredDrive]:
    """Read the windows of a table of numbers as drives.

    Parameters
    ----------
    path : Path or str
        ``.csv`` or ``.csv.gz`` with a header.
    vehicle : Vehicle
        Vehicle that drove.
    columns : Columns
        Columns of the table.
    windows : Windows, optional
        Choice of the windows. Default: `Windows()`.

    Raises
    ------
    IdentificationError
        If the table is wrong, naming row and column, or has no such window.
    OSError
        If it cannot be read.
    """
    recording = read_recording(path, columns, vehicle)
    steering = steering_of(recording, vehicle, columns)
    return list(select_windows(recording, vehicle, steering, windows).drives)


def select_windows(
    recording: Recording,
    vehicle: Vehicle,
    steering: SteeringMap,
    windows: Windows | None = None,
) -> Selection:
    """Return the windows of a recording as drives, and how many were left out, and why.

    Their times begin with the run-in; the signals are those of the window. Windows with a gap in
    the poses, the steering or the set-points of the speed, a jump of the poses or commands beyond
    what the model takes are left out.

    Parameters
    ----------
    recording : Recording
        From `read_recording`.
    vehicle : Vehicle
        Vehicle that drove.
    steering : SteeringMap
        From the recording's steering to the angle of the steering motor.
    windows : Windows, optional
        Choice of the windows. Default: `Windows()`.

    Raises
    ------
    IdentificationError
        If there is none.
    """
    windows = windows or Windows()
    motion = motion_of(recording)
    angle, turn_std = setpoints_of(recording, motion, vehicle, steering)
    check_agreement(recording, motion, vehicle, angle, turned_angle(motion, vehicle))
    drives = []
    left_out: Counter[str] = Counter()
    signals = _signals(recording, vehicle)
    lead = round(_run_in(recording, vehicle) / TICK)
    late = 0.0 if windows.overlapping else STEERING_LATE
    for first, reason in _beginnings(recording, motion, windows, lead, late):
        rows = slice(first - lead, first + round((windows.length + late) / TICK) + 1)
        if reason:
            left_out[reason] += 1
        elif np.abs(angle[rows]).max() > STEERING_END_STOP:
            left_out["steered beyond the end stop"] += 1
        else:
            drive = _drive(recording, signals, vehicle, motion, angle, rows, lead, windows.length)
            drives.append(
                dataclasses.replace(
                    drive,
                    turn_std=turn_std,
                    steering_late=late,
                    pose_filter=recording.pose_filter,
                    map_estimated=isinstance(steering, EstimatedMap),
                )
            )
    selection = Selection(tuple(drives), left_out, lead * TICK)
    if not drives:
        raise IdentificationError(
            f"{recording.name}: no window of {windows.length:g} s begins {lead * TICK:g} s after "
            f"the first pose or later, at more than {windows.above:g} m/s, without a gap or jump "
            f"of the poses in it or in the time before (left out: {selection}): choose a shorter "
            "length or a lower speed; or "
            f"{_question_of_units(recording, motion)}"
        )
    return selection


def _run_in(recording: Recording, vehicle: Vehicle) -> float:
    """Time [s] in which the model forgets how it began before a window.

    Commands that follow a measured speed begin with it; a speed loop with recorded set-points
    begins without the torque that it had.
    """
    if "speed_command" not in recording.more or not vehicle.has_speed_loop:
        return RUN_IN
    integral = vehicle.speed_gain_integral
    return RUN_IN + (SETTLED * vehicle.speed_gain_proportional / integral if integral else 0.0)


def _beginnings(
    recording: Recording, motion: Motion, windows: Windows, lead: int, late: float
) -> Iterator[tuple[int, str]]:
    """Ticks at which windows could begin, each with why that one is left out; empty: it is not.

    The commands of a window begin `lead` ticks before it and go on for `late` s after it. Ticks of
    a window that was used are not among those that follow, unless windows may overlap.
    """
    length = round(windows.length / TICK)
    jump = np.abs(motion.jolt) > JUMP
    jump |= motion.missed > max(MISSED * float(np.median(motion.missed)), LEAST_MISSED)
    reasons = {
        f"faster than {MAX_SPEED:g} m/s": np.abs(motion.speed) > MAX_SPEED,
        f"with a gap of the poses of more than {MAX_GAP:g} s": _in_gap(
            motion.time, recording.time, MAX_GAP
        ),
        "with a jump of the poses or a kink of the speed": jump,
        "with a jump of the yaw, as where it wraps and was interpolated": (
            np.abs(motion.turned) > TURNED
        ),
        **_gaps_of_inputs(recording, motion),
    }
    step, free = max(1, round(windows.every / TICK)), 0
    for first in range(0, len(motion.time) - length, step):
        last = first + (0 if windows.overlapping else length)
        if first < max(lead, free):
            continue
        if not motion.speed[first : last + 1].min() > windows.above:
            yield first, f"slower than {windows.above:g} m/s"
            continue
        rows = slice(first - lead, first + length + round(late / TICK) + 1)
        reason = next((reason for reason, there in reasons.items() if there[rows].any()), "")
        yield first, reason
        if not reason:
            free = 0 if windows.overlapping else first + length + 1


def _gaps_of_inputs(recording: Recording, motion: Motion) -> dict[str, NDArray[np.bool_]]:
    """Whether ticks (t,) are in a gap of the steering, or of the speed's set-points, in words."""
    inputs = {"steering": recording.steering}
    if "speed_command" in recording.more:
        inputs["speed_command"] = recording.more["speed_command"]
    found = {}
    for name, samples in inputs.items():
        steps = np.diff(samples.time, append=samples.time[-1])
        most = max(MAX_GAP, SPARSE * float(np.median(steps)))
        reason = f"with a gap of the {name} of more than {most:.2g} s"
        found[reason] = _in_gap(motion.time, samples.time, most)
    return found


def _in_gap(ticks: FloatArray, times: FloatArray, gap: float) -> NDArray[np.bool_]:
    """Whether ticks (t,) are in a larger gap between sample times, or so far outside of them."""
    found: NDArray[np.bool_] = (ticks < times[0] - gap) | (ticks > times[-1] + gap)
    large = np.diff(times) > gap
    for begin, end in zip(times[:-1][large], times[1:][large], strict=True):
        found |= (ticks > begin) & (ticks < end)
    return found


def _signals(recording: Recording, vehicle: Vehicle) -> dict[Sensor, Signal]:
    """All that was measured, on the clock of the recording."""
    poses = recording.poses
    found = {Sensor.POSITION: Signal(recording.time, poses[:, :2])}
    if recording.yaw is not None:
        found[Sensor.HEADING] = Signal(recording.time, poses[:, 2:])
    for name, sensor in MEASURED.items():
        if (samples := recording.more.get(name)) is not None:
            found[sensor] = Signal(samples.time, samples.values[:, None], STAMP_JITTER[sensor])
    if wheels := recording.wheel_speeds(vehicle):
        found[Sensor.WHEEL_SPEEDS] = of_wheels(wheels)
    return found


def _drive(
    recording: Recording,
    signals: Mapping[Sensor, Signal],
    vehicle: Vehicle,
    motion: Motion,
    angle: FloatArray,
    rows: slice,
    lead: int,
    length: float,
) -> MeasuredDrive:
    """Drive of the commands in some rows, with the signals of `length` s after `lead` of them."""
    time = motion.time[rows]
    start, begin, end = time[0] - APPROACH, time[lead], time[lead + round(length / TICK)]
    before = TICK * np.arange(round(APPROACH / TICK))
    turned = 0.5 - 0.5 * np.cos(np.pi * np.minimum(before / TURN_IN, 1.0))
    angle = np.concatenate([turned * angle[rows.start], angle[rows]])
    speed = np.concatenate([np.full(len(before), motion.speed[rows.start]), motion.speed[rows]])
    recorded = _recorded_setpoints(recording, vehicle, motion, rows)
    if recorded is None:
        commands = speed_followed(vehicle, angle, speed)
    else:
        driven = np.concatenate([speed[: len(before)], recorded])
        commands = Commands(TICK * np.arange(len(angle)), angle, driven)
    within = {sensor: signal.between(begin, end) for sensor, signal in signals.items()}
    own = {s: dataclasses.replace(v, time=v.time - start) for s, v in within.items()}
    name = recording.name.removesuffix(".gz").removesuffix(".csv")
    return MeasuredDrive(
        f"{name} {begin:.1f} s",
        commands,
        usable(own, vehicle),
        StartPose(speed=float(speed[0])),
        speed=speed if recorded is None else None,
        speed_std=motion.speed_std,
        recording=recording.name,
    )


def recorded_commands(
    recording: Recording, vehicle: Vehicle, steering: SteeringMap, start: float
) -> tuple[Commands, float]:
    """Return the commands of a recording from a time on to its end.

    With the standard deviation of the curvature that their steering gives [1/m].

    Parameters
    ----------
    recording : Recording
        From `read_recording`.
    vehicle : Vehicle
        Vehicle that drove.
    steering : SteeringMap
        From the recording's steering to the angle of the steering motor.
    start : float
        Time at which the commands begin [s].

    Raises
    ------
    CommandsError
        If they are beyond what the model takes.
    IdentificationError
        If a column contradicts the poses, or has a gap while the vehicle moves; or if the speed of
        the poses is to be followed, and is beyond what the model takes.
    """
    motion = motion_of(recording)
    angle, turn_std = setpoints_of(recording, motion, vehicle, steering)
    check_agreement(recording, motion, vehicle, angle, turned_angle(motion, vehicle))
    moving = (motion.time >= start) & (np.abs(motion.speed) > SLOWEST)
    for reason, gap in _gaps_of_inputs(recording, motion).items():
        if (gap & moving).any():
            raise IdentificationError(
                f"{recording.name}: drives {reason}, at {motion.time[gap & moving][0]:.2f} s: cut "
                "the table off there, or identify windows of it (tricycle identify --columns)"
            )
    first = np.searchsorted(motion.time, start - 0.5 * TICK)  # its tick, whatever its round-off
    rows = slice(int(first), len(motion.time))
    speed = _recorded_setpoints(recording, vehicle, motion, rows)
    if speed is None:
        fast = rows.start + np.flatnonzero(np.abs(motion.speed[rows]) > MAX_SPEED)
        if len(fast):
            raise IdentificationError(
                f"{recording.name}: drives faster than {MAX_SPEED:g} m/s, at "
                f"{motion.time[fast[0]]:.2f} s, or its poses jump there: cut the table off there, "
                "or identify windows of it (tricycle identify --columns)"
            )
        return speed_followed(vehicle, angle[rows], motion.speed[rows]), turn_std
    return Commands(TICK * np.arange(len(speed)), angle[rows], speed), turn_std


def _recorded_setpoints(
    recording: Recording, vehicle: Vehicle, motion: Motion, rows: slice
) -> FloatArray | None:
    """Set-points of the speed at the ticks; None where the speed of the poses is to be followed."""
    if "speed_command" not in recording.more:
        if not vehicle.has_speed_loop:
            raise IdentificationError(
                f"{recording.name}: needs speed_command, the set-points of the motor: parts.motor: "
                f"{vehicle.parts['motor']} follows no measured speed"
            )
        return None
    time = motion.time[rows]
    speed = recording.more["speed_command"].at(time, held=True)
    usual = float(np.median(np.abs(motion.speed[rows])))
    off = float(np.median(np.abs(speed - motion.speed[rows])))
    if vehicle.has_speed_loop and off > FAR_OFF * max(usual, SLOWEST):
        raise IdentificationError(
            f"{recording.name}: speed_command is {off:.2g} m/s off the speed of the poses, "
            f"{usual:.2g} m/s (medians from {time[0]:.1f} s on): it must be the set-points of a "
            "speed loop, not a throttle, in the unit of the mapping; without it the model is given "
            "the speed of the poses"
        )
    return speed
