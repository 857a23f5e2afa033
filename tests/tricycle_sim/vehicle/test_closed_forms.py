"""Vehicles of any structure against closed forms: loads, steady turns, stability, energy."""

import math

import numpy as np
import pytest
import structures

from tricycle_core.timing import TICK
from tricycle_sim.vehicle.live import LiveVehicle

SIDES = ("left", "right")
SOFTER = {"front_left.vertical_stiffness": 40000.0, "rear.vertical_stiffness": 90000.0}


def plain(**constants):
    return structures.vehicle_of(structures.PLAIN, **constants)


def four_springs(vehicle):
    """Loads of a rigid body on springs: their compression is a plane over the wheels' places.

    The tyres also take the pull of a tilted road, at the height of the road.
    """
    wheels = [vehicle.of(wheel) for wheel in vehicle.wheels]
    east, north = math.sin(vehicle.road_grade), math.sin(vehicle.road_bank)
    weight = vehicle.mass * vehicle.gravity
    up = math.sqrt(1.0 - east**2 - north**2)
    plane = np.array([[1.0, wheel.x, wheel.y] for wheel in wheels])
    stiffness = np.array([wheel.vertical_stiffness for wheel in wheels])
    moments = weight * np.array([up, -east * vehicle.com_height, -north * vehicle.com_height])
    compression = plane @ np.linalg.solve(plane.T @ (stiffness[:, np.newaxis] * plane), moments)
    return stiffness * compression


def test_static_loads_of_four_wheels_are_those_of_four_springs():
    vehicle = plain(**SOFTER, road_grade=0.05, road_bank=-0.1)
    assert vehicle.static_loads() == pytest.approx(four_springs(vehicle), rel=1e-9)


@pytest.mark.slow  # this and the next ones compile a structure
@pytest.mark.parametrize("road", [{}, {"road_grade": 0.05, "road_bank": -0.1}])
def test_four_wheels_carry_what_four_springs_carry(road):
    vehicle = plain(**SOFTER, **road, lateral_carcass_damping=60.0)  # or it swings on its tyres
    live = LiveVehicle(vehicle)
    for _ in range(300):
        live.step(brake=1.0)
    assert sum(live.state.loads) == pytest.approx(sum(four_springs(vehicle)), rel=1e-3)
    assert live.state.loads == pytest.approx(four_springs(vehicle), abs=0.5)


def turned(vehicle, speed, angle, seconds=6.0):
    """Yaw rate and speed in a steady turn; the start is gentle."""
    live = LiveVehicle(vehicle)
    ticks = round((speed + seconds) / TICK)
    for tick in range(ticks):
        state = live.step(steering=angle * min(1.0, tick * TICK), speed=min(speed, tick * TICK))
    return state.yaw_rate, state.vx


@pytest.mark.slow
@pytest.mark.parametrize(
    ("front", "rear"), [(1200.0, 1500.0), (1500.0, 1500.0)], ids=["understeer", "neutral"]
)
@pytest.mark.parametrize("laws", [("linear", "linear"), ("fiala", "magic_formula")], ids="-".join)
def test_understeer_gradient_is_that_of_the_bicycle(laws, front, rear):
    """By the steering that a steady turn needs beyond the wheelbase times its curvature."""
    parts = {"steering": "parallel", "front.tyre": laws[0], "rear.tyre": laws[1]}
    structure = structures.PLAIN | {"parts": parts}
    magic = laws[1] == "magic_formula"
    own = {f"rear.{name}": value for name, value in structures.MAGIC.items()} if magic else {}
    constants = {"front.cornering_stiffness": front, "rear.cornering_stiffness": rear}
    vehicle = structures.vehicle_of(structure, **own, **constants)
    a, b = 0.7, 0.8
    gradient = vehicle.mass / (a + b) * (b / (2.0 * front) - a / (2.0 * rear))
    needed, accelerations = [], []
    for speed in (1.0, 2.5, 4.0):
        rate, u = turned(vehicle, speed, 0.005)
        needed.append(0.005 / (rate / u) - (a + b))
        accelerations.append(u**2)
    assert needed == pytest.approx(gradient * np.array(accelerations), rel=0.002, abs=5e-5)


def growth(vehicle, setpoint):
    """Speed, and the rate at which a small turn grows by itself, after a push of the steering."""
    live = LiveVehicle(vehicle)
    start = round(setpoint / TICK) + 200
    rates = []
    for tick in range(start + 500):
        push = 1e-4 if start <= tick < start + 20 else 0.0
        state = live.step(steering=push, speed=min(setpoint, tick * TICK))
        rates.append(state.yaw_rate)
    return state.vx, math.log(rates[-1] / rates[-201]) / (200 * TICK)


@pytest.mark.slow
def test_critical_speed_is_that_of_the_bicycle():
    """An oversteering vehicle turns by itself from the speed at which its gain is infinite."""
    front, rear, a, b = 500.0, 150.0, 1.0, 0.5
    places = {f"{axle}_{side}.x": x for axle, x in (("front", a), ("rear", -b)) for side in SIDES}
    stiffness = {"front.cornering_stiffness": front, "rear.cornering_stiffness": rear}
    vehicle = plain(**places, **stiffness)
    critical = (a + b) * math.sqrt(2.0 * front * rear / (vehicle.mass * (a * front - b * rear)))
    (low, falls), (high, grows) = (growth(vehicle, share * critical) for share in (0.99, 1.03))
    assert falls < 0.0 < grows
    crossing = low - (high - low) * falls / (grows - falls)
    assert crossing == pytest.approx(critical, rel=0.005)


def energy(vehicle, state):
    """Of motion, height and the tyres' springs [J]."""
    wheels = [vehicle.of(wheel) for wheel in vehicle.wheels]
    velocity = np.array([state.vx, state.vy, state.vz])
    rate = np.array([state.roll_rate, state.pitch_rate, state.yaw_rate])
    inertia = (vehicle.roll_inertia, vehicle.pitch_inertia, vehicle.yaw_inertia)
    spins = np.array(state.wheel_speeds) + state.pitch_rate
    up = np.array([math.sin(vehicle.road_grade), 0.0, math.cos(vehicle.road_grade)])
    return (
        0.5 * vehicle.mass * velocity @ velocity
        + 0.5 * np.array(inertia) @ rate**2
        + 0.5 * np.array([wheel.wheel_inertia for wheel in wheels]) @ spins**2
        + vehicle.mass * vehicle.gravity * up @ (state.x, state.y, state.z)
        + sum(
            load**2 / (2.0 * wheel.vertical_stiffness)
            for load, wheel in zip(state.loads, wheels, strict=True)
        )
    )


def losses(vehicle, state):
    """Power of rolling resistance and air drag [W], straight ahead."""
    power = vehicle.air_drag * abs(state.vx) ** 3
    for load, spin, wheel in zip(state.loads, state.wheel_speeds, vehicle.wheels, strict=True):
        own = vehicle.of(wheel)
        radius = own.tyre_radius - load / own.vertical_stiffness
        rolling = own.rolling_coefficient_1 + own.rolling_coefficient_2 * (radius * spin) ** 2
        power += load * rolling * radius * abs(spin)
    return power


@pytest.mark.slow
@pytest.mark.parametrize("name", structures.STRUCTURES)
def test_the_motors_work_is_energy_and_losses(name):
    """Straight uphill under torque, then coasting: stiff tyres take hardly any."""
    straight = {"road_grade": 0.03, "air_drag": 0.4, "slip_stiffness": 2e4, "steering_offset": 0.0}
    if name != "rear_steered":
        del straight["steering_offset"]
    vehicle = structures.vehicle_of(structures.STRUCTURES[name], **straight)
    live = LiveVehicle(vehicle)
    work = lost = 0.0
    before = live.state
    start = energy(vehicle, before)
    for tick in range(600):
        state = live.step(torque=25.0 if tick < 400 else 0.0)
        power = before.motor_torque * before.drive_speed + state.motor_torque * state.drive_speed
        work += 0.5 * TICK * power
        lost += 0.5 * TICK * (losses(vehicle, before) + losses(vehicle, state))
        before = state
    assert state.vx > 1.5
    assert abs(state.vy) < 0.05
    assert energy(vehicle, state) - start + lost == pytest.approx(work, rel=0.005)
