"""The boards' constants against what they are made of."""

import math

import pytest

from tricycle_bridge.protocol import boards
from tricycle_bridge.protocol.limits import (
    ARMING_SPEED,
    MAX_ACCELERATION,
    MAX_SPEED,
    MAX_STEERING_ANGLE,
    STEERING_END_STOP,
)


def test_a_hall_pulse_is_an_edge_of_the_motor():
    """2 pi 0.335 m / (23 x 6) = 15.253 mm."""
    assert pytest.approx(2 * math.pi * boards.TYRE_RADIUS / (23 * 6), abs=5e-7) == boards.HALL_PULSE


def test_the_potentiometer_covers_the_steering_range_within_its_bounds():
    for angle in (-STEERING_END_STOP, STEERING_END_STOP):
        counts = boards.ADC_CENTRE + boards.ADC_SCALE * angle
        assert boards.ADC_LOW < counts < boards.ADC_HIGH


def test_both_supplies_fit_their_inputs():
    for volts in (boards.DRIVE_SUPPLY, boards.STEER_SUPPLY):
        assert volts / boards.SUPPLY_DIVIDER < 5.0


def test_the_largest_set_point_is_five_per_cent_before_the_end_stop():
    assert pytest.approx(0.95 * STEERING_END_STOP, abs=5e-5) == MAX_STEERING_ANGLE


def test_the_largest_speed_can_be_stopped_in_the_time_for_it():
    assert MAX_SPEED / MAX_ACCELERATION < boards.STOPPING_TIME < boards.HOLDING_TIME
    assert boards.AT_REST < ARMING_SPEED


def test_the_board_s_own_values_are_in_the_ranges_of_setup():
    for value, (low, high) in (
        (boards.HALL_PULSE, boards.HALL_PULSES),
        (boards.TYRE_RADIUS, boards.TYRE_RADII),
        (boards.MASS_LOW, boards.MASSES),
        (boards.MASS_HIGH, boards.MASSES),
    ):
        assert low < value < high
