"""Turn rate and angle of the steering motor against each other and against the linkage."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tricycle_bridge.commands.kinematics import TurningGeometry
from tricycle_bridge.protocol.limits import MAX_STEERING_ANGLE
from tricycle_core.errors import LinkError

TRICYCLE = TurningGeometry()


@given(st.floats(-MAX_STEERING_ANGLE, MAX_STEERING_ANGLE), st.floats(0.1, 4.0))
def test_the_tricycle_turns_as_its_linkage_says(theta, speed):
    outer = abs(theta) * (0.8 - 0.2 * abs(theta) / (math.pi / 4))
    wheel = (abs(theta) + outer) / 2  # mean of inner and outer
    road = math.atan(math.cos(math.radians(20)) * math.tan(wheel))
    rate = math.copysign(speed * math.tan(road) / 1.443, theta)
    largest = 0.44 * speed
    assert math.isclose(TRICYCLE.turn_rate(speed, theta), rate, abs_tol=1e-2 * largest)
    assert math.isclose(TRICYCLE.turn_rate(-speed, theta), -rate, abs_tol=1e-2 * largest)


@given(
    st.floats(-MAX_STEERING_ANGLE, MAX_STEERING_ANGLE),
    st.floats(0.1, 4.0),
    st.floats(0.2, 5.0),
)
def test_turn_rate_and_angle_invert_each_other(theta, speed, wheelbase):
    geometry = TurningGeometry(wheelbase=wheelbase)
    rate = geometry.turn_rate(speed, theta)
    assert math.isclose(geometry.motor_angle(speed, rate), theta, abs_tol=1e-9)


@given(st.floats(-1e6, 1e6), st.floats(1e-6, 10.0))
def test_what_the_steering_cannot_give_is_its_largest(rate, speed):
    angle = TRICYCLE.motor_angle(speed, rate)
    assert abs(angle) <= MAX_STEERING_ANGLE
    assert angle * rate >= 0.0


def test_a_steering_that_is_not_straight_at_rest():
    crooked = TurningGeometry(1.0, (-0.5, 0.0, 0.5), (-0.4, 0.1, 0.6))
    assert crooked.motor_angle(1.0, 0.0) == pytest.approx(-0.1)
    assert crooked.turn_rate(1.0, 0.0) == pytest.approx(math.tan(0.1))


@pytest.mark.parametrize(
    ("motor", "road", "problem"),
    [
        ((0.0, 0.1), (0.0,), "motor_angles has 2 numbers, road_angles 1: must be equally many"),
        ((0.0,), (0.0,), "at least 2"),
        ((0.0, 0.1), (0.1, 0.1), "road_angles: each number must be above the one before"),
        ((0.0, 2.0), (0.0, 0.1), "motor_angles: must be between -pi/2 and pi/2"),
        ((0.0, math.nan), (0.0, 0.1), "motor_angles: must be between -pi/2 and pi/2"),
    ],
)
def test_lists_that_are_no_steering_are_named(motor, road, problem):
    with pytest.raises(LinkError, match=problem):
        TurningGeometry(1.0, motor, road)
