"""One command history on many vehicles: what the planner and the user's command call.

The letters of shapes: `n` samples (vehicles), `k` unknown parameters, `t` time points, one every
`TICK` from 0 to the end. The work is divided into blocks of samples that threads take in turn.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tricycle_bridge.protocol.units import ANGLE_UNIT
from tricycle_core.cores import usable_cores
from tricycle_core.quantities import FloatArray, Progress
from tricycle_core.rotations import pitch_angle, roll_angle, yaw_angle
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands
from tricycle_sim.setpoints import command_rows, delayed, slew_all
from tricycle_sim.vehicle.body import BODY
from tricycle_sim.vehicle.constants import Vehicle
from tricycle_sim.vehicle.feasibility import SATURATED, Feasibility, read_feasibility
from tricycle_sim.vehicle.groups import equilibrium, pack, sample_values
from tricycle_sim.vehicle.kernel import COMMAND, functions_for
from tricycle_sim.vehicle.layout import (
    COMMANDED_ROWS,
    EVALUATED,
    LANES,
    SLOPE,
    STATE,
    WHEEL_EVALUATED,
    WHEEL_STATES,
    numbered,
)
from tricycle_sim.vehicle.parts import (
    BLOCK,
    ROWS,
    WHEEL,
    WHEEL_ROWS,
    servo_at_rest,
    steering_constants,
    structure_of,
)
from tricycle_sim.vehicle.sensing import lateral_specific_force, relative_spin
from tricycle_sim.vehicle.stability import check_step, lengthen_relaxation
from tricycle_sim.vehicle.wheels import Wheel

NOT_IN_FILES = "drive_speed", "lateral_acceleration", "motor_torque", "feasibility"


@dataclass(frozen=True)
class Trajectory:
    """Motion of n vehicles under the same commands.

    All arrays but `time` have shape (n, t). `vx, vy, vz` and the rates are in the body frame
    (REP-103, origin at the COM), the angles ZYX; positive pitch is nose down. Wheel speeds are
    relative to the body, as encoders see them; the yaw angle is continuous.
    """

    time: FloatArray  # s, shape (t,)
    x: FloatArray  # m, COM in the world
    y: FloatArray
    z: FloatArray
    roll: FloatArray  # rad
    pitch: FloatArray
    yaw: FloatArray
    vx: FloatArray  # m/s
    vy: FloatArray
    vz: FloatArray
    roll_rate: FloatArray  # rad/s
    pitch_rate: FloatArray
    yaw_rate: FloatArray
    wheel_speed: Mapping[str, FloatArray]  # rad/s, by wheel
    drive_speed: FloatArray  # rad/s, of the motor: mean of the driven wheels
    lateral_acceleration: FloatArray  # m/s^2, body frame at the COM: what an accelerometer reads
    motor_torque: FloatArray  # N m, at the driven wheels
    steering_motor_angle: FloatArray  # rad
    load: Mapping[str, FloatArray]  # N, by wheel
    feasibility: Feasibility

    def columns(self) -> dict[str, FloatArray]:
        """Return the columns of a file by name, `time` first: `load_left` of the wheel `left`."""
        columns: dict[str, FloatArray] = {}
        for entry in dataclasses.fields(self):
            value = getattr(self, entry.name)
            if isinstance(value, Mapping):
                columns |= {f"{entry.name}_{wheel}": column for wheel, column in value.items()}
            elif entry.name not in NOT_IN_FILES:
                columns[entry.name] = value
        return columns

    def __getattr__(self, name: str) -> FloatArray:
        """Return a wheel's column by the name that it has in files: `load_left`."""
        for kind in ("wheel_speed", "load"):
            wheel = name.removeprefix(f"{kind}_")
            if wheel != name and wheel in self.__dict__.get(kind, {}):
                return self.__dict__[kind][wheel]  # type: ignore[no-any-return]
        raise AttributeError(f"{name}: a trajectory has no such column")


def simulate(
    vehicle: Vehicle,
    commands: Commands,
    parameters: ArrayLike | None = None,
    *,
    speed: ArrayLike = 0.0,
    setpoint: float = 0.0,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Trajectory:
    """Simulate vehicles that differ in their unknown parameters, all with the same commands.

    Every vehicle starts in static equilibrium at the origin, heading +x. RK4 with steps of
    10 ms. Memory grows with n times t; `planar.simulate_planar` avoids that.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle whose wheels touch the ground.
    commands : Commands
        Commands, each held until the next.
    parameters : ndarray of float, shape (n, k), optional
        Values of `vehicle.unknown` in its order; by default the one nominal vehicle.
    speed : float or shape (n,)
        Speed at which the vehicles roll at the start [m/s]; by default they are at rest.
    setpoint : float
        Speed set-point before the first command [m/s].
    threads : int, optional
        Number of threads; by default one for each processor that this process may use.
    progress : callable, optional
        Called with the number of samples done and the number of all.

    Raises
    ------
    VehicleError
        If the vehicle is too stiff for the steps.
    ValueError
        If the parameters have another shape or are not finite.
    """
    samples = check_parameters(vehicle, parameters)
    speeds = np.broadcast_to(np.asarray(speed, dtype=float), len(samples))
    batch = CommandedBatch(vehicle, commands, setpoint=setpoint)
    wheels = [wheel.name for wheel in vehicle.wheels]
    names = [entry.name for entry in dataclasses.fields(Trajectory)]
    names = [name for name in names if name in batch.available]
    names += [f"{kind}_{wheel}" for kind in ("wheel_speed", "load") for wheel in wheels]
    out = {name: np.empty((len(samples), len(batch.time))) for name in names}
    angles = np.empty((len(samples), len(batch.time)))
    groups = np.empty((-(-len(samples) // LANES), ROWS * LANES))

    def store(first: int, last: int) -> None:
        run = batch.run(samples[first:last], names, speed=speeds[first:last])
        for name, column in run.columns.items():
            out[name][first:last] = column
        angles[first:last] = run.steering_motor_angle
        groups[first // LANES : -(-last // LANES)] = run.groups

    run_blocks(store, len(samples), threads, progress)
    columns: dict[str, Any] = {
        kind: {wheel: out.pop(f"{kind}_{wheel}") for wheel in wheels}
        for kind in ("wheel_speed", "load")
    }
    return Trajectory(
        time=batch.time,
        **columns | out,
        steering_motor_angle=angles,
        feasibility=read_feasibility(groups, len(samples), vehicle.wheels, batch.saturation),
    )


_ATTITUDE = (STATE.q0, STATE.q1, STATE.q2, STATE.q3)
_RATES = (STATE.p, STATE.q, STATE.r)
_BODY = numbered(BODY, first=BLOCK.body)
_ROWS = {
    "x": STATE.x,
    "y": STATE.y,
    "z": STATE.z,
    "vx": STATE.u,
    "vy": STATE.v,
    "vz": STATE.w,
    "vx_world": SLOPE + STATE.x,
    "vy_world": SLOPE + STATE.y,
    "roll_rate": STATE.p,
    "pitch_rate": STATE.q,
    "yaw_rate": STATE.r,
    "motor_torque": STATE.torque,
}


def _lateral_acceleration(_: FloatArray, *rows: FloatArray) -> FloatArray:
    q0, q1, q2, q3, u, w, p, r, slope, *gravity = rows
    x, y, z = gravity
    return lateral_specific_force((u, w), (p, r), slope, (q0, q1, q2, q3), (x, y, z))


def _itself(_: FloatArray, signal: FloatArray) -> FloatArray:
    return signal


# columns that follow from several rows: these, and how with the axles of the steering
_DERIVED: dict[str, tuple[tuple[int, ...], Callable[..., FloatArray]]] = {
    "roll": (_ATTITUDE, lambda _, *attitude: roll_angle(attitude)),
    "pitch": (_ATTITUDE, lambda _, *attitude: pitch_angle(attitude)),
    "yaw": (_ATTITUDE, lambda _, *attitude: np.unwrap(yaw_angle(attitude))),
    "lateral_acceleration": (
        (
            *(*_ATTITUDE, STATE.u, STATE.w, STATE.p, STATE.r, SLOPE + STATE.v),
            *(_BODY.gravity_x, _BODY.gravity_y, _BODY.gravity_z),
        ),
        _lateral_acceleration,
    ),
}


@dataclass(frozen=True, eq=False)
class Run:
    """Result of `CommandedBatch.run` for n samples.

    Attributes
    ----------
    columns : dict of str to ndarray of float, shape (n, t)
        Recorded columns, by name.
    steering_motor_angle : ndarray of float, shape (n, t)
        Angle of the steering motor [rad].
    groups : ndarray of float, shape (b, ROWS * LANES)
        Groups of the vehicles at the end.
    wheels : tuple of Wheel
        Wheels of the vehicle, in its order.
    saturation : str
        What a saturation of the steering is, in words.
    """

    columns: dict[str, FloatArray]
    steering_motor_angle: FloatArray
    groups: FloatArray
    wheels: tuple[Wheel, ...]
    saturation: str = SATURATED

    @property
    def feasibility(self) -> Feasibility:
        """Wheel loads, saturations and roll-over of each sample."""
        samples = len(next(iter(self.columns.values())))
        return read_feasibility(self.groups, samples, self.wheels, self.saturation)


class CommandedBatch:
    """One sequence of commands for any samples of a vehicle; steering is computed once.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle whose samples are simulated.
    commands : Commands
        Commands, each held until the next.
    setpoint : float
        Speed set-point before the first command [m/s].

    Attributes
    ----------
    time : ndarray of float, shape (t,)
        Times of all columns [s].
    steering_motor_angle : ndarray of float, shape (t,)
        Steering motor angle of the nominal vehicle [rad].
    saturation : str
        What the first saturation of the steering is, in words, if there is one.
    available : dict
        Every column that can be recorded, by name: the rows that it needs, and how it is computed.

    Raises
    ------
    VehicleError
        If the vehicle is too stiff for steps of 10 ms.
    """

    def __init__(self, vehicle: Vehicle, commands: Commands, *, setpoint: float = 0.0) -> None:
        check_step(vehicle, TICK)
        self._vehicle, self._functions = vehicle, functions_for(vehicle)
        self._setpoint = setpoint
        rows = command_rows(commands)
        ticks = len(rows)
        self.time = np.arange(ticks + 1, dtype=np.float64) * TICK
        setpoints, lag = slew_all(commands.steering_motor_angle[rows], vehicle.steering_slew)
        # what is beyond the end stop is never reached: the motor stays there
        beyond = np.abs(setpoints) - vehicle.steering_limit
        beyond[beyond < ANGLE_UNIT] = 0.0  # a board cannot tell it from the end stop
        self._lag = np.append(np.maximum(lag, beyond), 0.0)
        self.saturation = (
            f"steering asked to turn faster than steering_slew, {vehicle.steering_slew:g} rad/s,"
            if np.append(lag, 0.0)[np.argmax(self._lag > 0.0)] > 0.0
            else f"steering asked to turn beyond steering_limit, {vehicle.steering_limit:g} rad,"
        )
        speeds, _ = slew_all(commands.speed[rows], vehicle.acceleration, setpoint)
        self._drive = np.zeros((ticks + 1, len(COMMAND)))
        self._drive[:, COMMAND.speed_mode] = 1.0
        self._drive[:, COMMAND.demand] = np.append(speeds, speeds[-1:])
        self._table, angles = np.empty((2 * ticks + 1, 8)), np.empty((2, ticks + 1))
        constants = steering_constants(vehicle, 0.5 * TICK)
        self._functions.steer(servo_at_rest(vehicle), setpoints, constants, 2, self._table, angles)
        self.steering_motor_angle = angles[0]
        self._setpoints, self._start = setpoints, equilibrium(vehicle)
        self.available = self._columns()

    def _columns(self) -> dict[str, tuple[tuple[int, ...], Callable[..., FloatArray]]]:
        """Return `available`; a column follows from the axles (8, t) or (8, n, t) and rows."""
        columns = {name: ((row,), _itself) for name, row in _ROWS.items()} | _DERIVED

        def relative(side: int) -> Callable[..., FloatArray]:
            def speed(axles: FloatArray, spin: FloatArray, *rates: FloatArray) -> FloatArray:
                axle = None if side < 0 else axles[4 * side : 4 * side + 3]
                return relative_spin(spin, rates, axle)

            return speed

        structure = structure_of(self._vehicle)
        spins: list[int] = []
        for index, wheel in enumerate(self._vehicle.wheels):
            spins.append(STATE.spin + index * WHEEL_STATES)
            needs = (spins[-1], *_RATES)
            columns[f"wheel_speed_{wheel.name}"] = needs, relative(structure.sides[index])
            load = EVALUATED.load + index * WHEEL_EVALUATED
            columns[f"load_{wheel.name}"] = (load,), _itself

        driven = [index for index, wheel in enumerate(self._vehicle.wheels) if wheel.driven]
        shares = [WHEEL.torque_share + index * WHEEL_ROWS for index in driven]

        def mean(
            axles: FloatArray, p: FloatArray, q: FloatArray, r: FloatArray, *signals: FloatArray
        ) -> FloatArray:
            speeds = zip(driven, signals[: len(driven)], signals[len(driven) :], strict=True)
            total = np.zeros(p.shape)
            for index, spin, share in speeds:
                total += share * relative(structure.sides[index])(axles, spin, p, q, r)
            return total

        columns["drive_speed"] = (*_RATES, *(spins[index] for index in driven), *shares), mean
        return columns

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
        every: int = 1,
        on_card: FloatArray | None = None,
    ) -> Run:
        """Drive samples from the origin, heading +x, to the end of the commands.

        Parameters
        ----------
        parameters : ndarray of float, shape (n, k)
            Values of `vehicle.unknown` in its order.
        columns : sequence of str
            Columns to record: names of columns of `Trajectory`, or `vx_world`, `vy_world` [m/s];
            not the steering motor's angle.
        speed : ndarray of float, shape (n,), optional
            Speed at which the vehicles roll at the start [m/s]; by default they are at rest.
        steering_delay : ndarray of float, shape (n,), optional
            Additional delay of each servo's set-point [s]; default: none. The motion is smoother in
            it than in `servo_delay`, by which set-points change between ticks.
        drive_delay : float
            Additional delay of the motor's set-point [s].
        faster : ndarray of float, shape (n, t), optional
            Speed that is added to each motor's set-point [m/s]; default: none.
        steered : ndarray of float, shape (n, t), optional
            Angle that is added to each servo's set-point [rad], heard later like it; default: none.
        every : int
            Ticks from one recorded point to the next; t is then that of `time[::every]`.
        on_card : ndarray of float, optional
            Memory for what is recorded on the graphics card; default: on this thread's core.
        """
        drive = self._drive
        if drive_delay:
            drive, demand = drive.copy(), drive[:, COMMAND.demand]
            drive[:, COMMAND.demand] = delayed(demand, drive_delay, self._setpoint)
        needs = {name: self.available[name][0] for name in columns}
        rows = sorted({row for need in needs.values() for row in need})
        groups = pack(self._vehicle, parameters, self._start, speed)
        top_speed = float(np.abs(self._drive[:, COMMAND.demand]).max())
        lengthen_relaxation(groups, self._vehicle, top_speed)
        shape = len(rows), len(groups) * LANES, len(self.time[::every])
        changed = steering_delay, faster, steered
        own = bool(self._start.steered_by) or any(change is not None for change in changed)
        table, axles, angles = (
            self._own_commands(parameters, *changed)
            if own
            else (self._table, self._table[::2].T, self.steering_motor_angle)
        )
        if on_card is None:
            advance, out = functions_for(self._vehicle, own_commands=own).advance, np.empty(shape)
        else:
            from tricycle_sim.vehicle.graphics_card import advance_for

            advance = advance_for(self._vehicle, own_commands=own)
            out = on_card[: math.prod(shape)].reshape(shape)
        advance(groups, table, self._lag, drive, 1, 0, np.array(rows, dtype=np.int64), every, out)
        recorded = dict(zip(rows, out[:, : len(parameters)], strict=True))
        axles, angles = axles[..., ::every], angles[..., ::every]
        computed = {
            name: self.available[name][1](axles, *(recorded[row] for row in need))
            for name, need in needs.items()
        }
        angles = np.broadcast_to(angles, (len(parameters), angles.shape[-1]))
        return Run(computed, angles, groups, self._vehicle.wheels, self.saturation)

    def _own_commands(
        self,
        parameters: FloatArray,
        delays: FloatArray | None,
        faster: FloatArray | None,
        steered: FloatArray | None,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the table for `advance`, the axles at the ticks, the angles of the motor."""
        samples = len(parameters)
        delays = np.zeros(samples) if delays is None else delays
        count = -(-samples // LANES)
        table = np.empty((count, len(self._table), COMMANDED_ROWS, LANES))
        axles = np.empty((8, samples, len(self.time)))
        angles = np.empty((samples, len(self.time)))
        own, both = np.empty_like(self._table), np.empty((2, len(self.time)))
        differ = np.column_stack([parameters[:, self._start.steered_by], delays])
        if steered is not None:
            differ = np.column_stack([differ, steered])
        _, first, which = np.unique(differ, axis=0, return_index=True, return_inverse=True)
        by_lane = np.append(which, np.repeat(which[-1:], count * LANES - samples))
        by_group = by_lane.reshape(count, LANES)
        uniform = (by_group == by_group[:, :1]).all(axis=1)  # most are, and are filled at once
        for steering, sample in enumerate(first):
            values = sample_values(self._vehicle, parameters[sample])
            constants = steering_constants(self._vehicle, 0.5 * TICK, values)
            servo = servo_at_rest(self._vehicle)
            wanted = self._setpoints if steered is None else self._setpoints + steered[sample, :-1]
            setpoints = delayed(wanted, float(delays[sample]), 0.0)
            self._functions.steer(servo, setpoints, constants, 2, own, both)
            own_lanes = which.ravel() == steering
            axles[:, own_lanes], angles[own_lanes] = own[::2].T[:, np.newaxis], both[0]
            alike = by_group == steering
            table[uniform & alike[:, 0], :, :8] = own[:, :, np.newaxis]
            for group, lane in np.argwhere(alike & ~uniform[:, np.newaxis]):
                table[group, :, :8, lane] = own
        if faster is None:
            table[:, :, 8] = 0.0
        else:
            lanes = np.minimum(np.arange(count * LANES), samples - 1)  # the last one fills up
            of_groups = faster[lanes].reshape(count, LANES, -1).transpose(0, 2, 1)
            table[:, ::2, 8] = of_groups
            table[:, 1::2, 8] = 0.5 * (of_groups[:, :-1] + of_groups[:, 1:])
        return table.reshape(-1, COMMANDED_ROWS * LANES), axles, angles


def check_parameters(vehicle: Vehicle, parameters: ArrayLike | None) -> FloatArray:
    """Return the samples of `simulate`.

    Parameters
    ----------
    vehicle : Vehicle
        As for `simulate`.
    parameters : ndarray of float, shape (n, k), or None
        As for `simulate`.

    Raises
    ------
    ValueError
        As `simulate` does.
    """
    if parameters is None:
        return vehicle.nominal_point()[np.newaxis]
    samples = np.asarray(parameters, dtype=float)
    k = len(vehicle.unknown)
    if samples.ndim != 2 or samples.shape[1] != k or len(samples) == 0:
        raise ValueError(f"parameters: shape {samples.shape} instead of (n, {k})")
    if not np.all(np.isfinite(samples)):
        row, column = np.argwhere(~np.isfinite(samples))[0]
        raise ValueError(
            f"parameters: row {row + 1}: {list(vehicle.unknown)[column]} is not finite"
        )
    return samples


def run_blocks(
    run: Callable[[int, int], None],
    n: int,
    threads: int | None,
    progress: Progress | None,
) -> None:
    """Call a function for blocks of whole groups that cover n samples.

    Parameters
    ----------
    run : callable
        Called with the number of a block's first sample and the number after its last.
    n : int
        Number of samples.
    threads : int or None
        As for `simulate`.
    progress : callable or None
        As for `simulate`.
    """
    workers = threads or usable_cores()
    groups = -(-n // LANES)
    # several blocks per thread level out their loads; 16 groups bound the memory
    size = LANES * max(1, min(16, groups // (4 * workers) if workers > 1 else groups))
    bounds = [(first, min(first + size, n)) for first in range(0, n, size)]
    done = 0
    with ThreadPoolExecutor(workers) if workers > 1 else nullcontext() as pool:
        each = map if pool is None else pool.map
        for (first, last), _ in zip(bounds, each(lambda b: run(*b), bounds), strict=True):
            done += last - first
            if progress is not None:
                progress(done, n)
