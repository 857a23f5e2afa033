"""Vehicles in groups: constants and start of each one, at rest on its tyres or rolling."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tricycle_core.quantities import FloatArray
from tricycle_core.rotations import attitude_quaternion
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
from tricycle_sim.vehicle.parts import ROWS, group_constants
from tricycle_sim.vehicle.registry import wheel_values

STRAIGHT = np.array([[0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0]])
"""Table of a steering that stands straight ahead."""

_AT_REST = 1e-9  # m/s^2 and rad/s^2: a vehicle with smaller accelerations stands


@dataclass(frozen=True)
class Equilibrium:
    """How the nominal vehicle stands on its tyres.

    Attributes
    ----------
    pose : tuple of float
        Height of the COM [m], roll and pitch of the body [rad].
    shared : bool
        Whether vehicles stand so whatever their unknown parameters are.
    """

    pose: tuple[float, float, float]
    shared: bool


def equilibrium(vehicle: Vehicle) -> Equilibrium:
    """Return how the nominal vehicle stands on its tyres.

    Camber thrust is set aside (0.01 N): it depends on the unknown parameters.

    Parameters
    ----------
    vehicle : Vehicle
        With wheels that touch the ground.
    """
    nominal = vehicle.nominal_point()[np.newaxis]
    (pose,) = _settle(vehicle, nominal, np.array([[vehicle.com_height, 0.0, 0.0]]))
    extremes = np.array([*vehicle.unknown.values()]).reshape(-1, 2).T
    groups = _groups(vehicle, np.vstack([nominal, extremes]), camber_stiffness=0.0)
    accelerations = _accelerations(vehicle, groups, np.tile(pose, (3, 1)))
    height, roll, pitch = pose.tolist()
    shared = bool(np.abs(accelerations).max() < _AT_REST)
    return Equilibrium((height, roll, pitch), shared)


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
        Of which they are samples.
    parameters : ndarray of float, shape (n, k)
        Values of `vehicle.unknown`, in its order.
    start : Equilibrium
        Of the vehicle. Where the parameters move it, every sample stands in its own.
    speed : ndarray of float, shape (n,), optional
        At which they roll straight on [m/s]; by default they are at rest.

    Returns
    -------
    ndarray of float, shape (ceil(n / LANES), ROWS * LANES)
        Lanes beyond n repeat the last vehicle.
    """
    parameters = np.asarray(parameters, dtype=float)
    poses = np.array([start.pose])
    if not start.shared:
        poses = np.repeat(poses, len(parameters), axis=0)
        poses[:, 0] += _values(vehicle, parameters)["com_height"] - vehicle.com_height
        poses = _settle(vehicle, parameters, poses)
    groups = _groups(vehicle, parameters)
    _place(groups, poses)
    if speed is not None:
        groups[:, STATE.u] = _by_lane(speed)
        each = wheel_values(vehicle.wheels, _values(vehicle, parameters), vehicle.declared)
        for wheel, own in enumerate(each):
            spins = np.broadcast_to(speed / own.tyre_radius, len(parameters))
            groups[:, STATE.spin + wheel * WHEEL_STATES] = _by_lane(spins)
    return groups.reshape(len(groups), ROWS * LANES)


def _values(vehicle: Vehicle, parameters: FloatArray) -> dict[str, Any]:
    """Return the constants of samples by entry: numbers, and arrays (n,) of the unknown ones."""
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
        for name, value in _values(vehicle, parameters).items()
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


def _accelerations(vehicle: Vehicle, groups: FloatArray, poses: FloatArray) -> FloatArray:
    """Return vertical, roll and pitch acceleration (n, 3) of vehicles at rest in poses (n, 3)."""
    _place(groups, poses)
    flat = groups.reshape(len(groups), ROWS * LANES)
    advance = functions_for(vehicle).advance
    advance(flat, STRAIGHT, np.zeros(1), np.zeros((1, 3)), 1, 0, NO_ROWS, NO_OUTPUT)
    slopes = groups[:, [SLOPE + STATE.w, SLOPE + STATE.p, SLOPE + STATE.q]]
    return np.moveaxis(slopes, 1, 2).reshape(-1, 3)[: len(poses)]


def _settle(vehicle: Vehicle, parameters: FloatArray, poses: FloatArray) -> FloatArray:
    """Return the poses (n, 3) of vehicles at rest, from poses close to them."""
    steps = 1e-7 * np.vstack([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
    n, m = len(poses), len(steps)
    groups = _groups(vehicle, np.repeat(parameters, m, axis=0), camber_stiffness=0.0)
    for _ in range(8):  # Newton's method, Jacobian by central differences
        varied = (poses[:, np.newaxis] + steps).reshape(-1, 3)
        residuals = _accelerations(vehicle, groups, varied).reshape(n, m, 3)
        jacobian = np.swapaxes(residuals[:, 1:4] - residuals[:, 4:], 1, 2) / 2e-7
        poses = poses - np.linalg.solve(jacobian, residuals[:, 0, :, np.newaxis])[..., 0]
    return poses
