"""Vehicles in groups: constants and start of each one, at rest on its tyres or rolling."""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tricycle_core.errors import VehicleError
from tricycle_core.quantities import FloatArray
from tricycle_core.rotations import attitude_quaternion
from tricycle_core.timing import TICK
from tricycle_sim.vehicle.constants import Vehicle
from tricycle_sim.vehicle.kernel import NO_OUTPUT, NO_ROWS, functions_for
from tricycle_sim.vehicle.layout import (
    ALIVE,
    EVENT,
    EVENT_ROWS,
    LANES,
    SLOPE,
    STATE,
    WHEEL_STATES,
    of_wheels,
)
from tricycle_sim.vehicle.parts import (
    ROWS,
    group_constants,
    servo_at_rest,
    steering_columns,
    steering_constants,
)
from tricycle_sim.vehicle.registry import wheel_values

SETTLE_STEPS = 8
"""Steps of Newton's method from a first guess to the pose at rest."""
SETTLE_WIDTH = 1e-7
"""Step of the central differences in that method [m, rad]."""
_AT_REST = 1e-9  # m/s^2 and rad/s^2: a vehicle with smaller accelerations stands


def motor_in_the_middle(vehicle: Vehicle, point: FloatArray | None = None) -> FloatArray:
    """Return the table (1, 8) of a steering whose motor stands at 0.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with its steering linkage.
    point : ndarray of float, shape (k,), optional
        Values of `vehicle.unknown`, in its order; by default the nominal ones.
    """
    table, angles = np.empty((1, 8)), np.empty((2, 1))
    values = sample_values(vehicle, vehicle.nominal_point() if point is None else point)
    constants = steering_constants(vehicle, TICK, values)  # without set-points there is no step
    functions_for(vehicle).steer(servo_at_rest(vehicle), np.empty(0), constants, 1, table, angles)
    return table


@dataclass(frozen=True)
class Equilibrium:
    """How the nominal vehicle stands on its tyres.

    Attributes
    ----------
    pose : tuple of float
        Height of the COM [m], roll and pitch of the body [rad].
    moved_by : list of int
        Indices of the unknown parameters that change how a vehicle stands.
    steered_by : list of int
        Indices of those that change how it steers.
    """

    pose: tuple[float, float, float]
    moved_by: list[int]
    steered_by: list[int]


@functools.lru_cache(maxsize=256)
def equilibrium(vehicle: Vehicle) -> Equilibrium:
    """Return how the nominal vehicle stands on its tyres.

    Camber thrust is set aside (0.01 N): it depends on the unknown parameters.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle whose wheels touch the ground.
    """
    nominal, k = vehicle.nominal_point(), len(vehicle.unknown)
    steered_by = steering_columns(vehicle)
    (pose,) = _settle(vehicle, nominal[np.newaxis], steered_by)
    points = np.tile(nominal, (2 * k + 1, 1))  # the nominal one, and both ends of each range
    for column, ends in enumerate(vehicle.unknown.values()):
        points[2 * column : 2 * column + 2, column] = ends
    groups = _groups(vehicle, points, camber_stiffness=0.0)
    evaluate = _standing(vehicle, points, steered_by)
    moves = np.abs(_accelerations(evaluate, groups, np.tile(pose, (len(points), 1)))) >= _AT_REST
    height, roll, pitch = pose.tolist()
    moved_by = [column for column in range(k) if moves[2 * column : 2 * column + 2].any()]
    return Equilibrium((height, roll, pitch), moved_by, steered_by)


def pack(
    vehicle: Vehicle,
    parameters: FloatArray,
    start: Equilibrium,
    speed: FloatArray | None = None,
) -> FloatArray:
    """Put vehicles at the origin, heading +x, into groups.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle; the samples differ in its unknown parameters.
    parameters : ndarray of float, shape (n, k)
        Values of `vehicle.unknown`, in its order.
    start : Equilibrium
        Equilibrium of the vehicle. Where the parameters move it, every sample stands in its own.
    speed : ndarray of float, shape (n,), optional
        Speed at which they roll straight on [m/s]; by default they are at rest.

    Returns
    -------
    ndarray of float, shape (ceil(n / LANES), ROWS * LANES)
        Groups; lanes beyond n repeat the last vehicle.
    """
    parameters = np.asarray(parameters, dtype=float)
    poses = np.array([start.pose])
    if start.moved_by:
        _, first, which = np.unique(
            parameters[:, start.moved_by], axis=0, return_index=True, return_inverse=True
        )
        poses = _settle(vehicle, parameters[first], start.steered_by)[which.ravel()]
    groups = _groups(vehicle, parameters)
    _place(groups, poses)
    if speed is not None:
        groups[:, STATE.u] = _by_lane(speed)
        each = wheel_values(vehicle.wheels, sample_values(vehicle, parameters), vehicle.declared)
        for wheel, own in enumerate(each):
            spins = np.broadcast_to(speed / own.tyre_radius, len(parameters))
            groups[:, STATE.spin + wheel * WHEEL_STATES] = _by_lane(spins)
    return groups.reshape(len(groups), ROWS * LANES)


def sample_values(vehicle: Vehicle, parameters: FloatArray) -> dict[str, Any]:
    """Return the constants of samples by entry of a vehicle file.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle; the samples differ in its unknown parameters.
    parameters : ndarray of float, shape (n, k) or (k,)
        Values of `vehicle.unknown`, in its order.

    Returns
    -------
    dict of str to float or ndarray of float, shape (n,)
        Value of each constant; arrays for the unknown ones.
    """
    return {**vehicle.values, **dict(zip(vehicle.unknown, parameters.T, strict=True))}


def _by_lane(column: FloatArray) -> FloatArray:
    """Return a column (n,) by group and lane; lanes beyond n repeat the last entry."""
    missing = -len(column) % LANES
    return np.append(column, np.repeat(column[-1:], missing)).reshape(-1, LANES)


def _groups(vehicle: Vehicle, parameters: FloatArray, **aside: float) -> FloatArray:
    """Return groups (b, ROWS, LANES) of vehicles (n, k) at rest, with some values set aside."""
    groups = np.zeros((-(-len(parameters) // LANES), ROWS, LANES))
    values = {
        name: _by_lane(value) if name in vehicle.unknown else value
        for name, value in sample_values(vehicle, parameters).items()
    }
    values |= {name: value for name in values for end, value in aside.items() if _is(name, end)}
    for row, value in group_constants(vehicle, values).items():
        groups[:, row] = value
    groups[:, ALIVE] = 1.0
    groups[:, of_wheels(EVENT.least_load, EVENT_ROWS, len(vehicle.wheels))] = np.inf
    return groups


def _is(entry: str, constant: str) -> bool:
    return entry == constant or entry.endswith(f".{constant}")


def _place(groups: FloatArray, poses: FloatArray) -> None:
    """Put the vehicles of groups (b, ROWS, LANES) into poses (n, 3), or all into one (1, 3)."""
    groups[:, STATE.z] = _by_lane(poses[:, 0])
    attitudes = np.transpose([attitude_quaternion(r, p, 0.0) for _, r, p in poses.tolist()])
    for row, column in enumerate(attitudes, start=STATE.q0):
        groups[:, row] = _by_lane(column)


def _standing(
    vehicle: Vehicle, parameters: FloatArray, steered_by: list[int]
) -> Callable[[FloatArray], None]:
    """Return what writes the slopes of vehicles at rest, whose motors stand at 0, into groups."""
    own = bool(steered_by)
    if own:
        _, first, which = np.unique(
            parameters[:, steered_by], axis=0, return_index=True, return_inverse=True
        )
        tables = np.concatenate(
            [motor_in_the_middle(vehicle, point) for point in parameters[first]]
        )[which.ravel()]
        unchanged = np.zeros(len(parameters))  # the motor's demand
        lanes = [_by_lane(column) for column in (*tables.T, unchanged)]
        table = np.stack(lanes, axis=1).reshape(-1, len(lanes) * LANES)
    else:
        table = motor_in_the_middle(vehicle)
    advance = functions_for(vehicle, own_commands=own).advance

    def evaluate(groups: FloatArray) -> None:
        flat = groups.reshape(len(groups), ROWS * LANES)
        advance(flat, table, np.zeros(1), np.zeros((1, 3)), 1, 0, NO_ROWS, 1, NO_OUTPUT)

    return evaluate


def _accelerations(
    evaluate: Callable[[FloatArray], None], groups: FloatArray, poses: FloatArray
) -> FloatArray:
    """Return vertical, roll and pitch acceleration (n, 3) of vehicles at rest in poses (n, 3)."""
    _place(groups, poses)
    evaluate(groups)
    slopes = groups[:, [SLOPE + STATE.w, SLOPE + STATE.p, SLOPE + STATE.q]]
    return np.moveaxis(slopes, 1, 2).reshape(-1, 3)[: len(poses)]


def _settle(vehicle: Vehicle, parameters: FloatArray, steered_by: list[int]) -> FloatArray:
    """Return the poses (n, 3) of vehicles (n, k) at rest."""
    values = sample_values(vehicle, parameters)
    stiffness = sum(
        own.vertical_stiffness for own in wheel_values(vehicle.wheels, values, vehicle.declared)
    )
    # with all wheels on the ground: where one is lifted, its stiffness does not show
    poses = np.zeros((len(parameters), 3))
    poses[:, 0] = values["com_height"] - values["mass"] * values["gravity"] / stiffness
    steps = SETTLE_WIDTH * np.vstack([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
    n, m = len(poses), len(steps)
    repeated = np.repeat(parameters, m, axis=0)
    groups = _groups(vehicle, repeated, camber_stiffness=0.0)
    evaluate = _standing(vehicle, repeated, steered_by)
    for _ in range(SETTLE_STEPS):  # Jacobian by central differences
        varied = (poses[:, np.newaxis] + steps).reshape(-1, 3)
        residuals = _accelerations(evaluate, groups, varied).reshape(n, m, 3)
        jacobian = np.swapaxes(residuals[:, 1:4] - residuals[:, 4:], 1, 2) / (2.0 * SETTLE_WIDTH)
        try:
            poses = poses - np.linalg.solve(jacobian, residuals[:, 0, :, np.newaxis])[..., 0]
        except np.linalg.LinAlgError:
            raise VehicleError(
                f"{vehicle.name} finds no rest on its tyres: mass, com_height, "
                "vertical_stiffness or the wheels' places are wrong"
            ) from None
    return poses
