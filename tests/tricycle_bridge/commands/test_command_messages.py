"""From messages of commanders to commands of the vehicle."""

import math

import pytest

from tricycle_bridge.commands.command_messages import joint_command, limit_refusal, twist_command
from tricycle_bridge.commands.command_stream import VehicleCommand
from tricycle_bridge.commands.kinematics import TurningGeometry
from tricycle_bridge.settings import BridgeSettings
from tricycle_core.errors import LinkError
from tricycle_core.joints import REAR_WHEEL_JOINT, STEERING_JOINT

SETTINGS = BridgeSettings(max_speed=2.0, max_steering_angle=0.5)
STEER, WHEEL = STEERING_JOINT, REAR_WHEEL_JOINT


def twist(speed, turn_rate):
    return twist_command(speed, turn_rate, SETTINGS, TurningGeometry(), resting_angle=0.2)


def test_joints_in_any_order_among_others():
    names = [WHEEL, "bell", STEER]
    assert joint_command(names, [0, 0, 0.3], [2.0, 0, 0], 0.5) == VehicleCommand(0.3, 1.0)


@pytest.mark.parametrize(
    ("names", "positions", "velocities", "problem"),
    [
        ([], [], [], "must give position and velocity of"),
        ([STEER], [0.0], [0.0], "must give position and velocity of"),
        ([STEER, WHEEL], [0.0], [0.0], "must give position and velocity of"),
        ([STEER, WHEEL, STEER], [0.0] * 3, [0.0] * 3, f"{STEER} is there 2 times, must be once"),
        ([STEER, WHEEL], [math.nan, 0.0], [0.0, 0.0], "steering_motor_angle is nan"),
        ([STEER, WHEEL], [0.0, 0.0], [0.0, math.inf], "speed is inf"),
    ],
)
def test_joint_states_that_are_no_command_are_named(names, positions, velocities, problem):
    with pytest.raises(LinkError, match=problem):
        joint_command(names, positions, velocities, 0.335)


def test_a_twist_turns_as_the_steering_does():
    command = twist(1.0, 0.2)
    assert command.speed == 1.0
    assert 0.3 < command.steering_motor_angle < 0.4
    backwards = twist(-1.0, 0.2).steering_motor_angle
    assert backwards == pytest.approx(-command.steering_motor_angle)


def test_at_rest_the_steering_stays():
    assert twist(0.0, 0.0) == VehicleCommand(0.2, 0.0)


@pytest.mark.parametrize(
    ("speed", "turn_rate", "problem"),
    [
        (math.nan, 0.0, "speed is nan: must be a finite number"),
        (1.0, math.inf, "turn rate is inf: must be a finite number"),
        (1.0, 5.0, r"turn rate 5 rad/s at 1 m/s: the steering gives 0\.\d+ rad/s at most"),
        (0.0, 0.1, "turn rate 0.1 rad/s at 0 m/s: the steering gives 0 rad/s at most"),
    ],
)
def test_twists_that_cannot_be_driven_are_named(speed, turn_rate, problem):
    with pytest.raises(LinkError, match=problem):
        twist(speed, turn_rate)


@pytest.mark.parametrize(
    ("angle", "speed", "refusal"),
    [
        (0.5, 2.0, None),
        (-0.50005, -2.0005, None),  # rounded
        (0.51, 0.0, "steering angle 0.51 rad: at most 0.5 rad"),
        (0.0, -1e300, "speed -1e+300 m/s: at most 2 m/s"),
    ],
)
def test_what_exceeds_a_limit_by_more_than_rounding_is_named(angle, speed, refusal):
    assert limit_refusal(VehicleCommand(angle, speed), SETTINGS) == refusal
