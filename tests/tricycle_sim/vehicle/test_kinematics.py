"""How a vehicle turns, against what the simulated one does at walking pace."""

import numpy as np
import pytest
from structures import ALL_WHEELS, vehicle_of

from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.kinematics import (
    SteeredWheel,
    curvature,
    road_angles,
    steered_wheels,
)
from tricycle_sim.vehicle.live import LiveVehicle

VEHICLE = load_vehicle()
LONG = VEHICLE.replace(com_to_front_axle=1.0, com_to_rear_axle=1.0, tyre_radius=0.25)


@pytest.mark.parametrize("vehicle", [VEHICLE, LONG], ids=["packaged", "2 m"])
@pytest.mark.parametrize("motor_angle", [-0.6, 0.2, 0.7])
def test_the_vehicle_turns_as_its_kinematics_say(vehicle, motor_angle):
    live = LiveVehicle(vehicle)
    for _ in range(600):
        state = live.step(steering=motor_angle, speed=0.5)
    (road,) = road_angles(vehicle, np.array([motor_angle]))
    assert state.yaw_rate == pytest.approx(0.5 * np.tan(road) / vehicle.wheelbase, rel=0.05)


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_the_motor_turns_by_the_shares_of_its_wheels(share):
    vehicle = vehicle_of(ALL_WHEELS).replace(drive_front_share=share)
    live = LiveVehicle(vehicle)
    for _ in range(1000):
        state = live.step(steering=0.5, speed=0.3)
    (road,) = road_angles(vehicle, np.array([0.5]))
    pace = state.drive_speed * vehicle.driven_radius
    assert state.yaw_rate == pytest.approx(pace * np.tan(road) / vehicle.wheelbase, rel=0.03)


def test_the_inner_wheel_turns_more():
    left, right = (wheel.angle for wheel in steered_wheels(VEHICLE, 0.5).values())
    assert left > right > 0.0
    other_way = [wheel.angle for wheel in steered_wheels(VEHICLE, -0.5).values()]
    assert other_way == pytest.approx([-right, -left])


@pytest.mark.parametrize("wheelbase", [1.5, -1.5], ids=["front", "rear"])
@pytest.mark.parametrize("turn", [-1.2, 0.0, 0.3])
def test_wheels_that_agree_on_a_turn_make_it(wheelbase, turn):
    wheels = [
        SteeredWheel(wheelbase, y, np.arctan2(wheelbase * turn, 1.0 - y * turn))
        for y in (0.4, -0.3)
    ]
    assert curvature(wheels) == pytest.approx(turn, abs=1e-8)
    assert curvature(wheels[:1]) == pytest.approx(turn, abs=1e-8)
