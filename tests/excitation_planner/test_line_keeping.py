"""A vehicle whose steering has an offset is kept on its line; without a lead-in it leaves it."""

import math

import numpy as np
import pytest
from benchmark_modules import load_benchmark

from excitation_planner.line_keeping import LineKeeping
from excitation_planner.way_back.pursuit import Chassis

START = 2.0, -1.0, 0.7  # m, m, rad, of base_link
CHASSIS = Chassis()


@pytest.fixture(scope="module")
def benchmark():
    return load_benchmark("lead_in")


def end_of_straight(
    *,
    led: bool,
    offset: float = 0.02,
    speed: float = 2.0,
    time: float = 4.0,
    lag: float = 0.0,
    bias: float = 0.0,
):
    """Deviation to the left [m] and turn [rad] of a bicycle with an offset of its steering.

    Its steering follows with a lag [s], its yaw rate is measured with a bias [rad/s].
    """
    keeping = LineKeeping(START, time, CHASSIS)
    x, y, yaw = CHASSIS.axle(*START)
    steered = offset
    for tick in range(round(100 * time)):
        yaw_rate = CHASSIS.geometry.turn_rate(speed, steered)
        base = (
            x - CHASSIS.unsteered_axle * math.cos(yaw),
            y - CHASSIS.unsteered_axle * math.sin(yaw),
        )
        wanted = offset
        if led:
            wanted += keeping.steer((*base, yaw), speed, yaw_rate + bias, 0.01 * tick)
        x, y = x + 0.01 * speed * math.cos(yaw), y + 0.01 * speed * math.sin(yaw)
        steered += (wanted - steered) * min(0.01 / lag, 1.0) if lag else wanted - steered
        yaw += 0.01 * CHASSIS.geometry.turn_rate(speed, steered)
    ax, ay, _ = CHASSIS.axle(*START)
    aside = -(x - ax) * math.sin(START[2]) + (y - ay) * math.cos(START[2])
    return aside, yaw - START[2]


def test_open_loop_an_offset_of_the_steering_leads_astray():
    aside, turned = end_of_straight(led=False)
    assert aside > 0.3
    assert turned > math.radians(4.0)


@pytest.mark.parametrize("speed", [0.6, 2.0, 3.0, 4.8])
@pytest.mark.parametrize("lag", [0.0, 0.2])
def test_in_closed_loop_the_line_is_kept_at_any_speed(speed, lag):
    aside, turned = end_of_straight(led=True, speed=speed, lag=lag, time=6.0)
    assert abs(aside) < 0.005  # the offset is known by then
    assert abs(turned) < math.radians(0.2)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [3, 13])  # of the largest errors of the steering
def test_on_the_shortest_straight_the_maneuver_begins_within_5_cm_and_1_deg(benchmark, seed):
    aside, turned = benchmark.begun(benchmark.planned(0.0), seed, led=True)
    assert abs(aside) < 0.05
    assert abs(turned) < math.radians(1.0)


def test_a_yaw_rate_with_a_bias_does_not_lead_the_vehicle_astray():
    aside, turned = end_of_straight(led=True, bias=0.01, time=6.0)
    assert abs(aside) < 0.01
    assert abs(turned) < math.radians(0.1)


def test_a_wrong_yaw_rate_asks_for_no_sharp_turn():
    keeping = LineKeeping((0.0, 0.0, 0.0), 5.0, CHASSIS)
    angles = [keeping.steer((0.0, 0.0, 0.0), 2.0, 10.0, t) for t in np.arange(0.0, 5.0, 0.01)]
    assert min(angles) == pytest.approx(CHASSIS.motor_angle(-0.1), abs=1e-4)


def test_a_pose_far_off_asks_for_no_sharp_turn():
    keeping = LineKeeping((0.0, 0.0, 0.0), 5.0, CHASSIS)
    angles = [keeping.steer((float(t), 3.0, 0.0), 2.0, 0.0, t) for t in np.arange(0.0, 5.0, 0.01)]
    sharpest = CHASSIS.motor_angle(-0.1)
    assert min(angles) == pytest.approx(sharpest, abs=1e-4)


@pytest.mark.parametrize("back", [0.03, 0.09])
def test_a_clock_that_steps_back_leaves_the_steering_as_it_is(back):
    """It is tolerated up to 0.1 s; the correction must not grow beyond its limit then."""
    keeping = LineKeeping((0.0, 0.0, 0.0), 5.0, CHASSIS)
    angles = [keeping.steer((0.0, -0.3, 0.0), 1.0, 0.0, t) for t in np.arange(0.0, 1.0, 0.01)]
    assert keeping.steer((0.0, 0.3, 0.0), 1.0, 0.0, 0.99 - back) == angles[-1]
    assert keeping.steer((0.0, 0.3, 0.0), 1.0, 0.0, 1.0 - back) < angles[-1]
