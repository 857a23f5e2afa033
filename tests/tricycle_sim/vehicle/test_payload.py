"""A load moves mass, centre and inertia together."""

import dataclasses

import pytest

from tricycle_core.errors import VehicleError
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.live import LiveVehicle
from tricycle_sim.vehicle.payload import Payload, with_payload

VEHICLE = load_vehicle()


def test_no_load_changes_nothing():
    assert with_payload(VEHICLE, Payload(0.0, x=1.0)) == VEHICLE


def test_a_load_above_a_wheel_is_carried_by_that_wheel():
    over_rear = Payload(30.0, x=-VEHICLE.com_to_rear_axle, y=VEHICLE.rear_wheel_y)
    loaded = with_payload(VEHICLE, over_rear)
    left, right, rear = VEHICLE.static_loads()
    assert loaded.static_loads() == pytest.approx((left, right, rear + 30.0 * 9.81))
    assert LiveVehicle(loaded).state.loads == pytest.approx(loaded.static_loads(), abs=1.0)


def test_inertia_is_that_of_both_bodies_about_their_common_centre():
    loaded = with_payload(VEHICLE, Payload(30.0, x=0.3, y=-0.1, z=0.9))
    # Steiner, body by body
    mass, dx, dy, dz = VEHICLE.mass, 0.3, -0.1, 0.9 - VEHICLE.com_height
    cx, cy, cz = (30.0 * d / (mass + 30.0) for d in (dx, dy, dz))
    roll = mass * (cy**2 + cz**2) + 30.0 * ((dy - cy) ** 2 + (dz - cz) ** 2)
    yaw = mass * (cx**2 + cy**2) + 30.0 * ((dx - cx) ** 2 + (dy - cy) ** 2)
    assert loaded.roll_inertia == pytest.approx(VEHICLE.roll_inertia + roll)
    assert loaded.yaw_inertia == pytest.approx(VEHICLE.yaw_inertia + yaw)
    assert loaded.unknown["yaw_inertia"] == pytest.approx((25.0 + yaw, 75.0 + yaw))
    assert loaded.com_height == pytest.approx(VEHICLE.com_height + cz)


def test_ranges_move_with_the_values_that_they_are_about():
    unknown = {"mass": (40.0, 60.0), "com_height": (0.45, 0.55), "cornering_stiffness": (5e2, 2e3)}
    loaded = with_payload(dataclasses.replace(VEHICLE, unknown=unknown), Payload(30.0, z=1.5))
    higher = loaded.com_height - VEHICLE.com_height
    assert higher > 0.3
    assert loaded.unknown["mass"] == pytest.approx((70.0, 90.0))
    assert loaded.unknown["com_height"] == pytest.approx((0.45 + higher, 0.55 + higher))
    assert loaded.unknown["cornering_stiffness"] == (5e2, 2e3)


def test_a_load_beside_the_wheels_is_refused():
    with pytest.raises(VehicleError, match="right_wheel_y"):
        with_payload(VEHICLE, Payload(500.0, y=-2.0))
