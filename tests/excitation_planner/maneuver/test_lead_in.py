"""A lead-in puts a straight before a maneuver, and leaves the maneuver as it is."""

import numpy as np
import pytest

from excitation_planner.maneuver import (
    DrivenPath,
    family_by_name,
    family_names,
    lead_in_of,
    with_lead_in,
)
from excitation_planner.planning.replay import nominal_run
from tricycle_core.errors import PlanError
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import load_vehicle

VEHICLE = load_vehicle()


@pytest.mark.parametrize("name", family_names())
def test_the_nominal_vehicle_drives_the_same_maneuver_further_on(name):
    family = family_by_name(name)
    (led,) = with_lead_in([family], 3.0)
    assert (led.name, led.operation) == (family.name, family.operation)
    x = 0.5 * (np.array(family.operation.low) + np.array(family.operation.high))
    short, long = (nominal_run(VEHICLE, f, x) for f in (family, led))
    assert lead_in_of(long.commands, VEHICLE) > lead_in_of(short.commands, VEHICLE) + 1.0
    # from the first steering on, by heading, speed and way; whole periods of 20 ms are put in
    ends = [(r.reference.x[-1], r.reference.y[-1], r.reference.yaw[-1]) for r in (short, long)]
    np.testing.assert_allclose(np.subtract(*ends[::-1]), [3.0, 0.0, 0.0], atol=0.25)
    straight = long.commands.time < lead_in_of(long.commands, VEHICLE)
    assert np.abs(long.commands.steering_motor_angle[straight]).max() < 0.01


def test_without_more_straight_the_maneuver_is_the_family_s():
    family = family_by_name("circle")
    (led,) = with_lead_in([family], 0.0)
    x = np.array([3.0, 0.8])
    own, same = family.drive(x, VEHICLE), led.drive(x, VEHICLE)
    assert isinstance(own, DrivenPath)
    np.testing.assert_array_equal(own.x, same.x)
    assert own.length == same.length


def test_a_lead_in_ends_with_the_first_steering():
    time = np.arange(0.0, 5.0, 0.1)
    angle = np.where(time < 2.95, 0.0, 0.2)
    assert lead_in_of(Commands(time, angle, np.ones(50)), VEHICLE) == pytest.approx(3.0)
    assert lead_in_of(Commands(time, np.full(50, 0.2), np.ones(50)), VEHICLE) == 0.0


def test_a_steering_that_is_mounted_askew_is_straight_where_the_vehicle_is():
    askew = VEHICLE.replace(steering_offset=0.035)
    (led,) = with_lead_in([family_by_name("double_lane_change")], 2.0)
    ends = []
    for vehicle in (VEHICLE, askew):
        commands = nominal_run(vehicle, led, np.array([5.0, 5.0])).commands
        ends.append(lead_in_of(commands, vehicle))
    assert np.abs(commands.steering_motor_angle[0]) > 0.03
    assert ends[1] == pytest.approx(ends[0], abs=0.3)


@pytest.mark.parametrize("length", [-0.1, 1e3, np.nan])
def test_an_impossible_length_is_refused(length):
    with pytest.raises(PlanError, match=r"lead-in .* must be from 0 to 100 m"):
        with_lead_in([family_by_name("circle")], length)
