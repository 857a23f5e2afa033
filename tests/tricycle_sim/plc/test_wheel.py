"""What the check of the wheel says at once; `test_drive.py` drives with it."""

import pytest

from tricycle_bridge.protocol.boards import AGAINST_GEAR
from tricycle_sim.plc.wheel import WheelCheck


@pytest.mark.parametrize(("speed", "fails"), [(0.01, True), (-0.01, False)])
def test_a_speed_against_the_gear_is_a_contradiction_at_once(speed, fails):
    check = WheelCheck(pulse=0.05, radius=0.335, mass_low=40.0, mass_high=100.0)
    assert check.fails(torque=0.0, pulses=0, speed=-AGAINST_GEAR - speed, setpoint=1.0) is fails
