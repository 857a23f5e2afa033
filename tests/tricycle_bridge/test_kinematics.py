"""Steering angle of a turn rate against the forward geometry of the linkage."""

import math

from hypothesis import given
from hypothesis import strategies as st

from tricycle_bridge.kinematics import steering_motor_angle, turn_rate
from tricycle_bridge.protocol.limits import MAX_STEERING_ANGLE

CASTER = math.radians(20)


@given(st.floats(-MAX_STEERING_ANGLE, MAX_STEERING_ANGLE), st.floats(0.1, 4.0))
def test_it_inverts_the_linkage(theta, speed):
    outer = abs(theta) * (0.8 - 0.2 * abs(theta) / (math.pi / 4))
    wheel = (abs(theta) + outer) / 2  # mean of inner and outer
    track = math.atan(math.cos(CASTER) * math.tan(wheel))
    rate = math.copysign(speed * math.tan(track) / 1.443, theta)
    found = steering_motor_angle(speed, rate, wheelbase=1.443, caster_angle=CASTER)
    assert math.isclose(found, theta, abs_tol=1e-9)
    backwards = steering_motor_angle(-speed, -rate, wheelbase=1.443, caster_angle=CASTER)
    assert math.isclose(backwards, theta, abs_tol=1e-9)


@given(st.floats(-MAX_STEERING_ANGLE, MAX_STEERING_ANGLE), st.floats(0.1, 4.0))
def test_turn_rate_and_angle_invert_each_other(theta, speed):
    geometry = {"wheelbase": 1.443, "caster_angle": CASTER}
    rate = turn_rate(speed, theta, **geometry)
    assert math.isclose(steering_motor_angle(speed, rate, **geometry), theta, abs_tol=1e-9)


@given(st.floats(-1e6, 1e6), st.floats(1e-6, 10.0))
def test_every_turn_rate_has_a_side(rate, speed):
    angle = steering_motor_angle(speed, rate, wheelbase=1.443, caster_angle=CASTER)
    assert math.copysign(1.0, angle) == math.copysign(1.0, rate)
