"""The wheel's first pulses against the IMU."""

import dataclasses
import math

import numpy as np
import pytest

from tricycle_bridge.measurements.start_watch import StartWatch
from tricycle_bridge.protocol.messages import DriveState, layout

HELD = DriveState(**dict.fromkeys(layout(DriveState), 0) | {"brake": 200})


class Start:
    """A vehicle at rest on a slope whose brake is released."""

    def __init__(self, *, gravity=-0.49, rest=1.0):
        self.watch = StartWatch(0.015253)
        self.state, self.gravity, self.now = HELD, gravity, 100.0
        self.noise = np.random.default_rng(3)
        self.run(rest, 0.0)
        self.state = dataclasses.replace(HELD, brake=0)
        self.watch.look(self.state)

    def run(self, seconds, acceleration, *, step=0.01):
        """Travel that was felt when the problem was said, None if it was not."""
        speed = travel = 0.0
        for _ in range(round(seconds / step)):
            speed += acceleration * step
            travel += speed * step
            self.now += step
            self.watch.add_force(
                self.gravity + acceleration + 0.05 * self.noise.standard_normal(), self.now
            )
            self.watch.look(self.state)
            if self.watch.problem:
                return travel
        return None


@pytest.mark.parametrize("acceleration", [-0.5, 0.5, 2.9])
@pytest.mark.parametrize("gravity", [-0.49, 0.0, 0.49])
def test_a_start_without_pulses_is_told_after_three_pulses(gravity, acceleration):
    start = Start(gravity=gravity)
    assert abs(start.run(1.0, acceleration)) == pytest.approx(0.046, abs=0.025)
    sign = "+" if acceleration > 0 else "-"
    assert start.watch.problem.startswith(f"the imu has felt {sign}0.0")
    start.state = HELD
    start.watch.look(start.state)
    assert start.watch.problem is None


def test_one_pulse_is_enough():
    start = Start()
    assert start.run(0.2, 1.0) is None
    start.state = dataclasses.replace(start.state, hall_count=-1)
    assert start.run(3.0, 1.0) is None


def test_a_vehicle_that_does_not_move_for_three_seconds_does_not_drift_away():
    assert Start().run(3.0, 0.0) is None


def test_a_hard_stop_before_the_rest_is_no_start():
    start = Start(rest=0.0)
    start.run(1.0, -2.0)
    start.state = HELD
    start.run(0.55, 0.0)
    start.state = dataclasses.replace(HELD, brake=0)
    assert start.run(2.5, 0.0) is None


def test_without_rest_before_or_with_gaps_nothing_is_known():
    assert Start(rest=0.4).run(1.0, 1.0) is None
    assert Start().run(3.0, 1.0, step=0.16) is None


def test_what_is_not_known_is_not_watched():
    start = Start()
    start.watch.add_force(math.nan, start.now)
    assert start.run(0.2, 0.5) is None
    start.watch.look(None)
    start.watch.look(start.state)
    assert start.run(3.0, 0.5) is None
