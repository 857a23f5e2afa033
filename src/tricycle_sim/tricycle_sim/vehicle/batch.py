"""Replay of one command history on many vehicles: what the planner and the user's command call.

The letters of shapes: `n` samples (vehicles), `k` unknown parameters, `t` time points, one every
`TICK` from 0 to the end. The work is divided into blocks of samples that threads take in turn.
"""

import dataclasses
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from tricycle_core.quantities import TICK, FloatArray, Progress
from tricycle_core.rotations import euler_angles
from tricycle_sim.commands import Commands
from tricycle_sim.setpoints import command_rows, slew_all
from tricycle_sim.vehicle import kernel as dynamics
from tricycle_sim.vehicle.file import Vehicle
from tricycle_sim.vehicle.kernel import LANES, ROWS
from tricycle_sim.vehicle.stability import check_step
from tricycle_sim.vehicle.steering import run_servo, steering_constants

_PLANAR_ROWS = np.array([dynamics.X, dynamics.Y, dynamics.SLOPE, dynamics.SLOPE + 1])
_ALL_ROWS = np.array([*range(dynamics.STATES), *range(dynamics.LOAD, dynamics.LOAD + 3)])


@dataclass(frozen=True)
class Event:
    """Something that happened to each sample of a run, with its time and place.

    All of shape (n,). Where it did not happen, time and place are NaN.
    """

    value: FloatArray
    time: FloatArray  # s from the start
    x: FloatArray  # m, COM in the world
    y: FloatArray  # m

    @property
    def happened(self) -> NDArray[np.bool_]:
        """Which samples it happened to, shape (n,)."""
        return np.isfinite(self.time)


@dataclass(frozen=True)
class Feasibility:
    """What a drive asked of each of n vehicles, with time and place."""

    least_load_left: Event  # smallest load [N]; 0: the wheel lifted, then time and place of that
    least_load_right: Event
    least_load_rear: Event
    friction: Event  # largest share of a wheel's friction limit
    steering_saturated: Event  # first time the set-point fell behind the commands [rad]
    motor_saturated: Event  # first time the motor could not give the torque, what was missing [N m]
    rolled_over: Event  # the vehicle is at rest where it is from then on

    @property
    def wheel_lifted(self) -> NDArray[np.bool_]:
        """Which samples lifted a wheel, shape (n,)."""
        left, right, rear = self.least_load_left, self.least_load_right, self.least_load_rear
        return (left.value <= 0.0) | (right.value <= 0.0) | (rear.value <= 0.0)

    @property
    def feasible(self) -> NDArray[np.bool_]:
        """Which samples neither saturated the steering, lifted a wheel nor rolled over, (n,)."""
        bad = self.wheel_lifted | self.steering_saturated.happened | self.rolled_over.happened
        return ~bad

    def reasons(self, sample: int) -> tuple[str, ...]:
        """Return why a sample is infeasible, a line each with time and place."""
        reasons = [
            ("steering saturated", self.steering_saturated),
            ("left wheel lifted", _where_lifted(self.least_load_left)),
            ("right wheel lifted", _where_lifted(self.least_load_right)),
            ("rear wheel lifted", _where_lifted(self.least_load_rear)),
            ("rolled over", self.rolled_over),
        ]
        return tuple(
            f"{what} at {event.time[sample]:.2f} s, "
            f"x = {event.x[sample]:.2f} m, y = {event.y[sample]:.2f} m"
            for what, event in reasons
            if event.happened[sample]
        )


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
    wheel_speed_left: FloatArray  # rad/s
    wheel_speed_right: FloatArray
    wheel_speed_rear: FloatArray
    steering_motor_angle: FloatArray  # rad
    load_left: FloatArray  # N
    load_right: FloatArray
    load_rear: FloatArray
    feasibility: Feasibility

    def columns(self) -> dict[str, FloatArray]:
        """Return all columns by name, `time` first, in the order of the class."""
        names = [entry.name for entry in dataclasses.fields(self) if entry.name != "feasibility"]
        return {name: getattr(self, name) for name in names}


@dataclass(frozen=True)
class PlanarBlock:
    """Path of a block of b samples: position and velocity of the COM in the world."""

    time: FloatArray  # s, shape (t,)
    x: FloatArray  # m, shape (b, t)
    y: FloatArray
    vx_world: FloatArray  # m/s, shape (b, t)
    vy_world: FloatArray
    feasibility: Feasibility


def simulate(
    vehicle: Vehicle,
    commands: Commands,
    parameters: ArrayLike | None = None,
    *,
    speed: ArrayLike = 0.0,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Trajectory:
    """Replay commands on vehicles that differ in their unknown parameters.

    Every vehicle starts in static equilibrium at the origin, heading +x. RK4 with steps of
    10 ms. Memory grows with n times t; `simulate_planar` avoids that.

    Parameters
    ----------
    vehicle : Vehicle
    commands : Commands
    parameters : shape (n, k), optional
        Values of `vehicle.unknown` in its order; by default the one nominal vehicle.
    speed : float or shape (n,)
        At which the vehicles roll at the start [m/s]; by default they are at rest.
    threads : int, optional
        By default one for each processor this process may use.
    progress : callable, optional
        Called with the samples done and in all.

    Raises
    ------
    VehicleError
        If the vehicle is too stiff for the steps.
    ValueError
        If the parameters have another shape or are not finite.
    """
    samples = _check_parameters(vehicle, parameters)
    speeds = np.broadcast_to(np.asarray(speed, dtype=float), len(samples))
    replay = Replay(vehicle, commands)
    out = np.empty((len(_ALL_ROWS), -(-len(samples) // LANES) * LANES, len(replay.time)))
    groups = np.empty((out.shape[1] // LANES, ROWS, LANES))

    def store(first: int, last: int) -> None:
        packed = dynamics.pack(vehicle, samples[first:last], replay.pose, speeds[first:last])
        end = first + len(packed) * LANES
        block = np.empty((out.shape[0], end - first, out.shape[2]))
        replay.run(packed, _ALL_ROWS, block)
        out[:, first:end] = block
        groups[first // LANES : end // LANES] = packed.reshape(-1, ROWS, LANES)

    _run_blocks(store, len(samples), threads, progress)
    feasibility = read_feasibility(groups, len(samples))
    return _trajectory(replay, out[:, : len(samples)], feasibility)


def simulate_planar(
    vehicle: Vehicle,
    commands: Commands,
    parameters: ArrayLike | None,
    reduce: Callable[[int, PlanarBlock], None],
    *,
    threads: int | None = None,
    progress: Progress | None = None,
) -> None:
    """Replay commands block by block of samples, without keeping the trajectories.

    Parameters
    ----------
    vehicle, commands, parameters, threads, progress
        As for `simulate`.
    reduce : callable
        Called with the number of the block's first sample and the block, from several threads at a
        time and in any order; each sample comes once. The arrays are its to keep.
    """
    samples = _check_parameters(vehicle, parameters)
    replay = Replay(vehicle, commands)

    def reduce_block(first: int, last: int) -> None:
        groups = dynamics.pack(vehicle, samples[first:last], replay.pose)
        out = np.empty((len(_PLANAR_ROWS), len(groups) * LANES, len(replay.time)))
        replay.run(groups, _PLANAR_ROWS, out)
        x, y, vx, vy = out[:, : last - first]
        feasibility = read_feasibility(groups.reshape(-1, ROWS, LANES), last - first)
        reduce(first, PlanarBlock(replay.time, x, y, vx, vy, feasibility))

    _run_blocks(reduce_block, len(samples), threads, progress)


class Replay:
    """Everything of a replay that is the same for all samples: set-points and steering.

    `time` (t,) and the `pose` at the start are for its callers, who `run` groups packed with it.
    """

    def __init__(self, vehicle: Vehicle, commands: Commands) -> None:
        check_step(vehicle, TICK)
        rows = command_rows(commands)
        ticks = len(rows)
        self.time = np.arange(ticks + 1, dtype=np.float64) * TICK
        setpoints, lag = slew_all(commands.steering_motor_angle[rows], vehicle.steering_slew)
        self._lag = np.append(lag, 0.0)
        speeds, _ = slew_all(commands.speed[rows], vehicle.acceleration)
        self._drive = np.zeros((ticks + 1, 3))
        self._drive[:, dynamics.SPEED_MODE] = 1.0
        self._drive[:, dynamics.DEMAND] = np.append(speeds, speeds[-1:])
        self.table = np.empty((2 * ticks + 1, 8))
        self.angles = np.empty((2, ticks + 1))
        self.pose = dynamics.equilibrium(vehicle)
        constants = steering_constants(vehicle, 0.5 * TICK)
        run_servo(np.zeros(2), setpoints, constants, 2, self.table, self.angles)

    def run(self, groups: FloatArray, rows: NDArray[np.int64], out: FloatArray) -> None:
        """Advance groups from their start to the end; see `dynamics.advance`."""
        dynamics.advance(groups, self.table, self._lag, self._drive, 1, 0, rows, out)


def _check_parameters(vehicle: Vehicle, parameters: ArrayLike | None) -> FloatArray:
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


def _run_blocks(
    run: Progress,
    n: int,
    threads: int | None,
    progress: Progress | None,
) -> None:
    """Call `run(first, last)` for blocks of whole groups that cover n samples."""
    workers = threads or len(os.sched_getaffinity(0))
    groups = -(-n // LANES)
    # several blocks per thread level out their loads; 16 groups bound the memory
    size = LANES * max(1, min(16, groups // (4 * workers)))
    bounds = [(first, min(first + size, n)) for first in range(0, n, size)]
    done = 0
    with ThreadPoolExecutor(workers) as pool:
        for (first, last), _ in zip(bounds, pool.map(lambda b: run(*b), bounds), strict=True):
            done += last - first
            if progress is not None:
                progress(done, n)


def read_feasibility(groups: FloatArray, n: int) -> Feasibility:
    """Read the events of n samples; `groups` of shape (b, ROWS, LANES)."""

    def event(row: int) -> Event:
        value, tick, x, y = groups[:, row : row + 4].transpose(1, 0, 2).reshape(4, -1)[:, :n]
        # only the least loads start above 0, at infinity, and they always happen
        never = value == 0.0 if row > dynamics.LEAST_LOAD_REAR else np.zeros(n, dtype=bool)
        time, x, y = (np.where(never, np.nan, item) for item in (tick * TICK, x, y))
        return Event(value.copy(), time, x, y)

    friction = event(dynamics.FRICTION)
    return Feasibility(
        least_load_left=event(dynamics.LEAST_LOAD_LEFT),
        least_load_right=event(dynamics.LEAST_LOAD_RIGHT),
        least_load_rear=event(dynamics.LEAST_LOAD_REAR),
        friction=dataclasses.replace(friction, value=np.sqrt(friction.value)),
        steering_saturated=event(dynamics.STEERING),
        motor_saturated=event(dynamics.MOTOR),
        rolled_over=event(dynamics.ROLLOVER),
    )


def _where_lifted(load: Event) -> Event:
    never = load.value > 0.0
    return dataclasses.replace(load, time=np.where(never, np.nan, load.time))


def _trajectory(replay: Replay, states: FloatArray, feasibility: Feasibility) -> Trajectory:
    """Turn recorded rows, shape (rows, n, t), into the columns of a trajectory."""
    roll, pitch, yaw = euler_angles(states[dynamics.Q0 : dynamics.Q3 + 1])
    p, q, r = states[dynamics.P : dynamics.R + 1]
    axles = replay.table[::2].T  # at the ticks, shape (8, t)
    x, y, z = states[dynamics.X : dynamics.Z + 1]
    vx, vy, vz = states[dynamics.U : dynamics.W + 1]
    load_left, load_right, load_rear = states[dynamics.STATES :]
    return Trajectory(
        time=replay.time,
        x=x,
        y=y,
        z=z,
        roll=roll,
        pitch=pitch,
        yaw=np.unwrap(yaw),
        vx=vx,
        vy=vy,
        vz=vz,
        roll_rate=p,
        pitch_rate=q,
        yaw_rate=r,
        wheel_speed_left=states[dynamics.SPIN_LEFT] - (p * axles[0] + q * axles[1] + r * axles[2]),
        wheel_speed_right=states[dynamics.SPIN_RIGHT]
        - (p * axles[4] + q * axles[5] + r * axles[6]),
        wheel_speed_rear=states[dynamics.SPIN_REAR] - q,
        steering_motor_angle=np.broadcast_to(replay.angles[0], p.shape),
        load_left=load_left,
        load_right=load_right,
        load_rear=load_rear,
        feasibility=feasibility,
    )
