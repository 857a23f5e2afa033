"""What the check of the wheel says tick by tick; `test_drive.py` drives with it."""

import math

import pytest

from tricycle_bridge.protocol.boards import AGAINST_GEAR, PULSE_MARGIN, RESISTANCE, TORQUE_LAG
from tricycle_core.timing import TICK
from tricycle_sim.plc.wheel import WheelCheck

PULSE, RADIUS, LIGHT, HEAVY = 0.05, 0.335, 40.0, 100.0


@pytest.fixture
def check():
    return WheelCheck(PULSE, RADIUS, LIGHT, HEAVY)


def failing_time(check, ticks, **what):
    """Time of the first tick that fails [s]; infinite: none."""
    for k in range(1, ticks + 1):
        if check.fails(**what):
            return k * TICK
    return math.inf


@pytest.mark.parametrize(("speed", "fails"), [(0.01, True), (-0.01, False)])
def test_a_speed_against_the_gear_is_a_contradiction_at_once(check, speed, fails):
    assert check.fails(torque=0.0, pulses=0, speed=-AGAINST_GEAR - speed, setpoint=1.0) is fails


def test_a_wheel_without_pulses_fails_when_the_heaviest_vehicle_would_have_moved_uphill(check):
    torque = 60.0
    gain = torque / (RADIUS * HEAVY) - RESISTANCE  # m/s^2
    moved = TORQUE_LAG + math.sqrt(2.0 * PULSE_MARGIN * PULSE / gain)
    time = failing_time(check, 200, torque=torque, pulses=0, speed=0.0, setpoint=0.0)
    assert time == pytest.approx(moved, rel=0.06)


@pytest.mark.parametrize(("torque", "fails"), [(60.0, True), (0.0, False)])
def test_a_speed_that_does_not_grow_with_the_torque_fails(torque, fails):
    """Its pulses come often enough that no travel is missing between two of them."""
    pulse, mass, push = 0.015, 60.0, 60.0
    check = WheelCheck(pulse, RADIUS, 0.9 * mass, 1.1 * mass)
    speed = travel = 0.0
    for _ in range(100):
        speed += TICK * push / (RADIUS * mass)
        before, travel = travel, travel + TICK * speed
        pulses = math.floor(travel / pulse) - math.floor(before / pulse)
        assert not check.fails(push, pulses, speed, setpoint=speed)
    pulses = round(TICK * speed / pulse)
    time = failing_time(check, 200, torque=torque, pulses=pulses, speed=speed, setpoint=speed)
    assert (time < math.inf) is fails
