"""Tracking: the nominal vehicle stays on the path, its commands within what PLCs do at once."""

import numpy as np
import pytest

from excitation_planner.maneuver.paths import Circle, DoubleLaneChange
from excitation_planner.maneuver.tracking import COMMAND_TICKS, track
from tricycle_bridge.protocol.units import ANGLE_UNIT, SPEED_UNIT
from tricycle_core.timing import TICK
from tricycle_sim.vehicle import Vehicle, load_vehicle
from tricycle_sim.vehicle.batch import simulate
from tricycle_sim.vehicle.constants import constant_entries
from tricycle_sim.vehicle.wheels import Wheel

VEHICLE = load_vehicle()
PERIOD = COMMAND_TICKS * TICK
MANEUVERS = [
    (Circle(), (3.0, 0.8)),
    (Circle(), (6.0, 1.0)),
    (DoubleLaneChange(), (4.0, 4.0)),
    (DoubleLaneChange(), (0.0, 8.0)),
]


def tracked(family, x):
    drive = family.drive(np.array(x), VEHICLE)
    return drive, track(VEHICLE, drive)


def steered_behind():
    """The tricycle driven the other way round: front wheels driven, the rear one steered."""
    wheels = (
        Wheel("left", "front", driven=True, braked=True),
        Wheel("right", "front", driven=True, braked=True),
        Wheel("rear", "rear", steered=True),
    )
    parts = {"steering": "parallel"}
    known = constant_entries(wheels, parts)
    values = {name: value for name, value in VEHICLE.values.items() if name in known}
    return Vehicle(name="rear", values=values, unknown={}, parts=parts, wheels=wheels)


@pytest.mark.slow
def test_the_unsteered_axle_stays_on_the_path_where_the_rear_one_is_steered():
    vehicle = steered_behind()
    drive = Circle().drive(np.array([4.0, 0.8]), vehicle)
    tracking = track(vehicle, drive)
    assert tracking.infeasible == ""
    motion = simulate(vehicle, tracking.commands)
    a = vehicle.com_to_front_axle
    front = np.column_stack(
        [motion.x[0] + a * np.cos(motion.yaw[0]), motion.y[0] + a * np.sin(motion.yaw[0])]
    )
    path = np.column_stack([drive.x, drive.y])
    distance = np.min(np.linalg.norm(front[::10, None] - path[None], axis=2), axis=1)
    assert distance.max() < 0.25


@pytest.mark.parametrize(("family", "x"), MANEUVERS)
def test_the_rear_axle_stays_on_the_path(family, x):
    drive, tracking = tracked(family, x)
    assert tracking.infeasible == ""
    motion = simulate(VEHICLE, tracking.commands)
    b = VEHICLE.com_to_rear_axle
    rear = np.column_stack(
        [motion.x[0] - b * np.cos(motion.yaw[0]), motion.y[0] - b * np.sin(motion.yaw[0])]
    )
    path = np.column_stack([drive.x, drive.y])
    distance = np.min(np.linalg.norm(rear[::10, None] - path[None], axis=2), axis=1)
    assert distance.max() < 0.25
    assert np.sqrt(np.mean(distance**2)) < 0.1


@pytest.mark.parametrize(("family", "x"), MANEUVERS)
def test_no_limiter_acts_on_the_commands(family, x):
    _, tracking = tracked(family, x)
    commands = tracking.commands
    assert np.allclose(np.diff(commands.time), PERIOD)
    steps = np.abs(np.diff(commands.steering_motor_angle))
    assert steps.max() <= VEHICLE.steering_slew * PERIOD + ANGLE_UNIT
    assert np.abs(np.diff(commands.speed)).max() <= VEHICLE.acceleration * PERIOD + SPEED_UNIT
    feasibility = simulate(VEHICLE, commands).feasibility
    assert feasibility.feasible[0]
    assert not feasibility.steering_saturated.happened[0]


@pytest.mark.parametrize(("family", "x"), MANEUVERS)
def test_commands_are_what_the_protocol_can_say(family, x):
    commands = tracked(family, x)[1].commands
    for values, unit in ((commands.steering_motor_angle, ANGLE_UNIT), (commands.speed, SPEED_UNIT)):
        assert np.allclose(values / unit, np.round(values / unit), atol=1e-6)


def test_a_circle_that_the_steering_cannot_hold_is_infeasible():
    _, tracking = tracked(Circle(operation=Circle().operation), (1.5, 1.0))
    assert tracking.infeasible.startswith("the steering saturates at ")
    assert " s: it may turn to 0.7461 rad, 5 % before its end stop" in tracking.infeasible


@pytest.mark.parametrize(("margin", "most"), [(0.0, 0.7854), (0.05, 0.7461), (0.1, 0.7068)])
def test_the_steering_keeps_its_margin_before_the_end_stop(margin, most):
    vehicle = VEHICLE.replace(steering_margin=margin)
    commands = track(vehicle, Circle().drive(np.array([1.5, 1.0]), vehicle)).commands
    assert np.abs(commands.steering_motor_angle).max() == pytest.approx(most)


def test_the_vehicle_starts_at_rest_and_reaches_its_speed():
    _, tracking = tracked(Circle(), (3.0, 0.8))
    assert tracking.commands.speed[0] == pytest.approx(VEHICLE.acceleration * PERIOD)
    assert tracking.commands.speed[-1] == pytest.approx(0.8)


def test_another_vehicle_needs_other_commands():
    slow = VEHICLE.replace(steering_slew=0.3)
    drive = Circle().drive(np.array([3.0, 0.8]), slow)
    commands = track(slow, drive).commands
    assert np.abs(np.diff(commands.steering_motor_angle)).max() <= 0.3 * PERIOD + ANGLE_UNIT


@pytest.mark.parametrize(("radius", "speed"), [(6.0, 0.6), (4.5, 0.6), (6.0, 0.7)])
def test_on_a_slow_wide_circle_the_steering_comes_to_rest(radius, speed):
    _, tracking = tracked(Circle(), (radius, speed))
    last = tracking.commands.steering_motor_angle[-250:]  # 5 s
    assert np.ptp(last) < 0.005
    motion = simulate(VEHICLE, tracking.commands)
    assert motion.feasibility.feasible[0]
