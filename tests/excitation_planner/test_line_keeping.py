"""A vehicle whose steering has an offset is kept on its line; without a lead-in it leaves it."""

import math

import numpy as np
import pytest

from excitation_planner.line_keeping import LineKeeping
from excitation_planner.way_back.pursuit import Chassis

START = 2.0, -1.0, 0.7  # m, m, rad, of base_link
CHASSIS = Chassis()


def end_of_straight(*, led: bool, offset: float = 0.02, speed: float = 2.0, time: float = 4.0):
    """Deviation to the left [m] and turn [rad] of a bicycle with an offset of its steering."""
    keeping = LineKeeping(START, time, CHASSIS)
    x, y, yaw = CHASSIS.axle(*START)
    for tick in range(round(100 * time)):
        base = (
            x - CHASSIS.unsteered_axle * math.cos(yaw),
            y - CHASSIS.unsteered_axle * math.sin(yaw),
        )
        angle = keeping.steer((*base, yaw), speed, 0.01 * tick) if led else 0.0
        x, y = x + 0.01 * speed * math.cos(yaw), y + 0.01 * speed * math.sin(yaw)
        yaw += 0.01 * CHASSIS.geometry.turn_rate(speed, angle + offset)
    ax, ay, _ = CHASSIS.axle(*START)
    aside = -(x - ax) * math.sin(START[2]) + (y - ay) * math.cos(START[2])
    return aside, yaw - START[2]


def test_open_loop_an_offset_of_the_steering_leads_astray():
    aside, turned = end_of_straight(led=False)
    assert aside > 0.3
    assert turned > math.radians(4.0)


@pytest.mark.parametrize("speed", [0.6, 2.0, 3.0])
def test_in_closed_loop_the_line_is_kept_at_any_speed(speed):
    aside, turned = end_of_straight(led=True, speed=speed)
    assert abs(aside) < 0.03
    assert abs(turned) < math.radians(0.3)


def test_a_pose_far_off_asks_for_no_sharp_turn():
    keeping = LineKeeping((0.0, 0.0, 0.0), 5.0, CHASSIS)
    angles = [keeping.steer((float(t), 3.0, 0.0), 2.0, t) for t in np.arange(0.0, 5.0, 0.01)]
    sharpest = CHASSIS.motor_angle(-0.1)
    assert min(angles) == pytest.approx(sharpest, abs=1e-4)


@pytest.mark.parametrize("back", [0.03, 0.09])
def test_a_clock_that_steps_back_leaves_the_steering_as_it_is(back):
    """It is tolerated up to 0.1 s; the correction must not grow beyond its limit then."""
    keeping = LineKeeping((0.0, 0.0, 0.0), 5.0, CHASSIS)
    angles = [keeping.steer((0.0, -0.3, 0.0), 1.0, t) for t in np.arange(0.0, 1.0, 0.01)]
    assert keeping.steer((0.0, 0.3, 0.0), 1.0, 0.99 - back) == angles[-1]
    assert keeping.steer((0.0, 0.3, 0.0), 1.0, 1.0 - back) < angles[-1]
