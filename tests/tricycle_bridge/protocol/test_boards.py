"""The boards' constants against what they are made of."""

import math

import pytest

from tricycle_bridge.protocol import boards
from tricycle_bridge.protocol.limits import MAX_ACCELERATION, MAX_SPEED, MAX_STEERING_ANGLE


def test_a_hall_pulse_is_an_edge_of_the_motor():
    """2 pi 0.335 m / (23 x 6) = 15.253 mm."""
    assert pytest.approx(2 * math.pi * 0.335 / (23 * 6), abs=5e-7) == boards.HALL_PULSE


def test_the_potentiometer_covers_the_steering_range_within_its_bounds():
    for angle in (-MAX_STEERING_ANGLE, MAX_STEERING_ANGLE):
        counts = boards.ADC_CENTRE + boards.ADC_SCALE * angle
        assert boards.ADC_LOW < counts < boards.ADC_HIGH


def test_both_supplies_fit_their_inputs():
    for volts in (boards.DRIVE_SUPPLY, boards.STEER_SUPPLY):
        assert volts / boards.SUPPLY_DIVIDER < 5.0


def test_an_overspeed_is_beyond_the_largest_set_point_and_a_ramp_from_it_is_no_stall():
    assert boards.OVERSPEED > MAX_SPEED
    assert boards.AT_REST < boards.STALL_SPEED < MAX_ACCELERATION * boards.STALL_TIME
