"""What any correct implementation of the model shows: prints the table of docs/model.md.

    python benchmarks/vehicle_checks.py

`tests/tricycle_sim/vehicle/test_kernel.py` holds each figure to its bound.
"""

import dataclasses
import importlib.util
import itertools
import math
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from tricycle_core.rotations import attitude_quaternion
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands
from tricycle_sim.setpoints import slew_all
from tricycle_sim.vehicle import Vehicle, load_vehicle
from tricycle_sim.vehicle.batch import simulate
from tricycle_sim.vehicle.groups import equilibrium, pack
from tricycle_sim.vehicle.kernel import functions_for
from tricycle_sim.vehicle.layout import (
    EVALUATED,
    LANES,
    STATE,
    STATES,
    WHEEL_EVALUATED,
    WHEEL_STATES,
    of_wheels,
)
from tricycle_sim.vehicle.parts import ROWS, steering_constants
from tricycle_sim.vehicle.stability import LIMIT, fastest_mode

Array = NDArray[np.float64]


def load_oracle() -> ModuleType:
    """Import the independent model of the tests."""
    path = Path(__file__).parents[1] / "tests/tricycle_sim/vehicle/lagrange_oracle.py"
    spec = importlib.util.spec_from_file_location("lagrange_oracle", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def run(
    vehicle: Vehicle,
    steering: Array,
    drive: Array,
    *,
    substeps: int = 1,
    start: dict[int, float] | None = None,
) -> tuple[Array, Array]:
    """Run the nominal vehicle through set-points per tick from any state.

    `steering` (t,), `drive` (t, 3) as for `Functions.advance`, `start` row: value of a state.
    Returns the states (STATES, t + 1) and the loads (3, t + 1).
    """
    ticks = len(steering)
    functions = functions_for(vehicle)
    groups = pack(vehicle, vehicle.nominal_point()[np.newaxis], equilibrium(vehicle))
    for row, value in (start or {}).items():
        groups.reshape(-1, LANES)[row] = value
    table, angles = np.empty((2 * substeps * ticks + 1, 8)), np.empty((2, ticks + 1))
    servo = np.zeros(2)
    constants = steering_constants(vehicle, 0.5 * TICK / substeps)
    functions.steer(servo, steering, constants, 2 * substeps, table, angles)
    loads = of_wheels(EVALUATED.load, WHEEL_EVALUATED, len(vehicle.wheels))
    rows = np.array([*range(STATES), *range(*loads.indices(ROWS))])
    out = np.empty((len(rows), LANES, ticks + 1))
    functions.advance(
        groups,
        table,
        np.zeros(ticks + 1),
        np.vstack([drive, drive[-1:]]),
        substeps,
        0,
        rows,
        1,
        out,
    )
    return out[:STATES, 0], out[STATES:, 0]


def rolling(vehicle: Vehicle, speed: float, *, yaw: float = 0.0) -> dict[int, float]:
    """Start rolling straight ahead at a speed, without slip."""
    _, roll, pitch = equilibrium(vehicle).pose
    start = dict(
        zip(
            (STATE.q0, STATE.q1, STATE.q2, STATE.q3),
            attitude_quaternion(roll, pitch, yaw),
            strict=True,
        )
    )
    start[STATE.u], start[STATE.w] = speed * math.cos(pitch), speed * math.sin(pitch)
    for row in range(STATE.spin, STATES, WHEEL_STATES):
        start[row] = speed / vehicle.tyre_radius
    return start


def coasting(ticks: int) -> Array:
    """Drive commands without any torque."""
    return np.zeros((ticks, 3))


def at_speed(ticks: int, speed: float) -> Array:
    """Drive commands of a constant speed set-point."""
    return np.tile([1.0, speed, 0.0], (ticks, 1))


def static_loads(vehicle: Vehicle) -> Array:
    """Loads left, right, rear [N] after two seconds at rest."""
    trajectory = simulate(vehicle, Commands([0.0, 2.0], [0.0, 0.0], [0.0, 0.0]))
    loads = (trajectory.load_left, trajectory.load_right, trajectory.load_rear)
    return np.array([load[0, -1] for load in loads])


def steady_yaw_rate(vehicle: Vehicle, speed: float, stiffness: float) -> tuple[float, float]:
    """Yaw rate [rad/s] in a gentle turn: of the model, and of the linear bicycle."""
    vehicle = vehicle.replace(
        cornering_stiffness=stiffness, self_aligning_stiffness=0.0, camber_stiffness=25.0
    )
    # camber thrust is no part of the bicycle: known to be 0 here
    vehicle = without_camber(vehicle)
    motor_angle = 0.01
    states, _ = run(
        vehicle,
        np.full(1500, motor_angle),
        at_speed(1500, speed),
        start=rolling(vehicle, speed),
    )
    u, r = states[STATE.u, -1], states[STATE.r, -1]
    wheel_angles = functions_for(vehicle).wheel_angles
    left, right, _, _ = wheel_angles(motor_angle, steering_constants(vehicle, 0.5 * TICK))
    angle = math.cos(vehicle.caster_angle) * 0.5 * (left + right)
    a, b = vehicle.com_to_front_axle, vehicle.com_to_rear_axle
    front, rear = 2.0 * stiffness, stiffness
    understeer = vehicle.mass / (a + b) * (b / front - a / rear)
    return r, u * angle / (a + b + understeer * u**2)


def without_camber(vehicle: Vehicle) -> Vehicle:
    """Return the vehicle without camber thrust, which is then no longer unknown."""
    unknown = {n: limits for n, limits in vehicle.unknown.items() if n != "camber_stiffness"}
    return dataclasses.replace(vehicle, unknown=unknown).replace(camber_stiffness=0.0)


def mirror_error(vehicle: Vehicle) -> float:
    """Largest deviation [m] of a mirrored drive from the mirror image, on a symmetric track."""
    vehicle = vehicle.replace(left_wheel_y=0.31, right_wheel_y=-0.31, rear_wheel_y=0.0)
    time = np.arange(0.0, 10.01, 0.02)
    left = simulate(vehicle, Commands(time, 0.2 * np.sin(time), np.minimum(time, 2.0)))
    right = simulate(vehicle, Commands(time, -0.2 * np.sin(time), np.minimum(time, 2.0)))
    return float(max(np.abs(left.x - right.x).max(), np.abs(left.y + right.y).max()))


def rotation_error(vehicle: Vehicle, yaw: float = 1.0) -> float:
    """Largest deviation [m] of a drive with rotated start from the rotated drive."""
    time = np.arange(1000) * TICK
    steering, drive = 0.2 * np.sin(time), at_speed(1000, 2.0)
    straight, _ = run(vehicle, steering, drive, start=rolling(vehicle, 2.0))
    turned, _ = run(vehicle, steering, drive, start=rolling(vehicle, 2.0, yaw=yaw))
    c, s = math.cos(yaw), math.sin(yaw)
    x, y = straight[STATE.x], straight[STATE.y]
    deviation = (c * x - s * y - turned[STATE.x], s * x + c * y - turned[STATE.y])
    return float(np.abs(deviation).max())


def coast_down(vehicle: Vehicle) -> tuple[float, float]:
    """Seconds from 3 to 2 m/s on rolling resistance: of the model, and in closed form."""
    states, _ = run(vehicle, np.zeros(3000), coasting(3000), start=rolling(vehicle, 3.0))
    speed = states[STATE.u]
    crossing = np.interp([-3.0 + 1e-3, -2.0], -speed, np.arange(len(speed)) * TICK)
    f1, f2 = vehicle.rolling_coefficient_1, vehicle.rolling_coefficient_2
    spins = 2.0 * vehicle.front_wheel_inertia + vehicle.rear_wheel_inertia
    mass = vehicle.mass + spins / vehicle.tyre_radius**2
    rate = vehicle.mass * vehicle.gravity / mass * math.sqrt(f1 * f2)
    scale = math.sqrt(f2 / f1)
    closed = (math.atan((3.0 - 1e-3) * scale) - math.atan(2.0 * scale)) / rate
    return float(crossing[1] - crossing[0]), closed


def wheel_lift(vehicle: Vehicle, side: float) -> tuple[float, float]:
    """Lateral acceleration [m/s^2] when the inner wheel lifts: model, and rigid vehicle.

    A slowly tightening turn, speed set to 3.4 m/s; `side` 1: left, -1: right.
    """
    ticks = 6000
    steering = side * np.linspace(0.0, 0.7, ticks)
    states, loads = run(vehicle, steering, at_speed(ticks, 3.4), start=rolling(vehicle, 3.4))
    inner = loads[0 if side > 0 else 1]
    tick = int(np.argmax(inner <= 0.0))
    u, v, r = states[[STATE.u, STATE.v, STATE.r], tick]
    measured = math.hypot(u, v) * abs(r)
    # rigid: the vehicle tips over the line from the outer front to the rear contact
    outer = vehicle.right_wheel_y if side > 0 else vehicle.left_wheel_y
    a, b = vehicle.com_to_front_axle, vehicle.com_to_rear_axle
    arm = abs(vehicle.rear_wheel_y + (outer - vehicle.rear_wheel_y) * b / (a + b))
    return measured, vehicle.gravity * arm / vehicle.com_height


def kinematic_radius(vehicle: Vehicle, degrees: float) -> tuple[float, float]:
    """Radius [m] of the rear axle at 0.5 m/s, both wheels at an angle: model, and kinematic."""
    vehicle = without_camber(vehicle.replace(steering_ratio_straight=1.0, steering_ratio_full=1.0))
    angle = math.radians(degrees)
    states, _ = run(vehicle, np.full(2000, angle), at_speed(2000, 0.5), start=rolling(vehicle, 0.5))
    u, v, r = states[[STATE.u, STATE.v, STATE.r], -1]
    radius = math.hypot(u, v - vehicle.com_to_rear_axle * r) / r
    wheelbase = vehicle.com_to_front_axle + vehicle.com_to_rear_axle
    return radius, wheelbase / (math.cos(vehicle.caster_angle) * math.tan(angle))


def energy(vehicle: Vehicle, states: Array) -> Array:
    """Mechanical energy [J] of a drive straight ahead: motion, height, vertical tyre springs."""
    q0, q1, q2, q3 = states[STATE.q0 : STATE.q3 + 1]
    e = np.array([2 * (q1 * q3 - q0 * q2), 2 * (q2 * q3 + q0 * q1), 1 - 2 * (q1**2 + q2**2)])
    inertia = (vehicle.roll_inertia, vehicle.pitch_inertia, vehicle.yaw_inertia)
    spin_inertia = (*2 * (vehicle.front_wheel_inertia,), vehicle.rear_wheel_inertia)
    total = vehicle.mass * vehicle.gravity * states[STATE.z]
    total += 0.5 * vehicle.mass * np.sum(states[STATE.u : STATE.w + 1] ** 2, axis=0)
    total += 0.5 * np.array(inertia) @ states[STATE.p : STATE.r + 1] ** 2
    total += 0.5 * np.array(spin_inertia) @ states[of_wheels(STATE.spin, WHEEL_STATES, 3)] ** 2
    height = vehicle.tyre_radius - vehicle.com_height
    for x, y in (
        (vehicle.com_to_front_axle, vehicle.left_wheel_y),
        (vehicle.com_to_front_axle, vehicle.right_wheel_y),
        (-vehicle.com_to_rear_axle, vehicle.rear_wheel_y),
    ):
        lean = np.sqrt(1.0 - e[1] ** 2)
        radius = (states[STATE.z] + np.array([x, y, height]) @ e) / lean
        compression = np.maximum(0.0, vehicle.tyre_radius - radius)
        total += 0.5 * vehicle.vertical_stiffness * compression**2
    return total


def largest_energy_rise(vehicle: Vehicle) -> float:
    """Largest rise [J] within 10 ms, coasting straight at 2 m/s from 3 mm above equilibrium."""
    start = rolling(vehicle, 2.0)
    start[STATE.z] = equilibrium(vehicle).pose[0] + 0.003
    states, _ = run(vehicle, np.zeros(500), coasting(500), start=start)
    return float(np.diff(energy(vehicle, states)).max())


def integration_errors(vehicle: Vehicle, *, mean: float = 0.15) -> dict[float, float]:
    """Planar error [m] after 4 s of sine steer by step [ms], against the oracle's DOP853.

    From rest, up to 2 m/s at 1 m/s^2, steering `mean` +- 0.1 rad at 0.5 Hz, commands held for
    20 ms. The linkage has a kink in its slope at the centre: crossing it costs order.
    """
    oracle = load_oracle()
    ticks = 400
    time = np.arange(ticks) // 2 * 2 * TICK
    targets = mean + 0.1 * np.sin(math.pi * time)
    steering, _ = slew_all(targets, vehicle.steering_slew)
    speed, _ = slew_all(np.minimum(time, 2.0), vehicle.acceleration)
    described, pose = oracle.describe(vehicle), equilibrium(vehicle).pose
    exact = oracle.simulate(described, pose, steering, speed, TICK, rtol=1e-12)
    errors = {}
    drive = np.column_stack([np.ones(ticks), speed, np.zeros(ticks)])
    for substeps in (1, 2, 4, 8):
        states, _ = run(vehicle, steering, drive, substeps=substeps)
        deviation = states[[STATE.x, STATE.y], -1] - exact[-1, :2]
        errors[1e3 * TICK / substeps] = float(np.hypot(*deviation))
    return errors


def main() -> int:
    """Print the table."""
    vehicle = load_vehicle()

    def line(check: str, figure: str) -> None:
        print(f"{check:<62} {figure}")

    expected = vehicle.static_loads()
    for wheel, load, exact in zip(
        ("left", "right", "rear"), static_loads(vehicle), expected, strict=True
    ):
        line(f"static load {wheel}: model, moment balance [N]", f"{load:.2f} {exact:.2f}")
    for speed in (0.95, 2.93):
        for stiffness in (500.0, 1500.0):
            model, bicycle = steady_yaw_rate(vehicle, speed, stiffness)
            line(
                f"steady yaw rate at {speed} m/s, {stiffness:g} N/rad: off the linear bicycle",
                f"{100 * (model / bicycle - 1):+.2f} %",
            )
    line("mirrored steering: off the mirror image", f"{mirror_error(vehicle):.1e} m")
    line("rotated start: off the rotated trajectory", f"{rotation_error(vehicle):.1e} m")
    model, closed = coast_down(vehicle)
    line("coast-down 3 to 2 m/s: model, closed form", f"{model:.3f} s {closed:.3f} s")
    for name, side in (("left", 1.0), ("right", -1.0)):
        model, rigid = wheel_lift(vehicle, side)
        line(f"wheel lift turning {name}: model, rigid [m/s^2]", f"{model:.3f} {rigid:.3f}")
    for degrees in (5.0, 15.0):
        model, kinematic = kinematic_radius(vehicle, degrees)
        line(
            f"radius at 0.5 m/s, wheels at {degrees:g} deg: model, kinematic [m]",
            f"{model:.3f} {kinematic:.3f} ({100 * (model / kinematic - 1):+.2f} %)",
        )
    line("largest rise of energy in 10 ms, coasting", f"{largest_energy_rise(vehicle):.1e} J")
    line(
        "fastest mode, and what steps of 10 ms allow [rad/s]",
        f"{fastest_mode(vehicle)[0]:.1f} {LIMIT / TICK:.0f}",
    )
    errors = integration_errors(vehicle)
    for step, error in errors.items():
        line(f"planar error after 4 s, RK4 steps of {step:g} ms", f"{error:.1e} m")
    values = list(errors.values())
    ratios = ", ".join(f"{a / b:.1f}" for a, b in itertools.pairwise(values))
    line("error ratios per halving", ratios)
    for step, error in integration_errors(vehicle, mean=0.0).items():
        line(f"the same steering through the centre, steps of {step:g} ms", f"{error:.1e} m")
    return 0


if __name__ == "__main__":
    sys.exit(main())
