"""Returns on the 9-DOF vehicle; `benchmarks/way_back.py` runs a hundred of them."""

import math

import numpy as np
import pytest
from benchmark_modules import load_benchmark

from excitation_planner.area.area import Area
from excitation_planner.area.tube import footprint_of
from excitation_planner.way_back.dubins import Arc
from excitation_planner.way_back.pursuit import Chassis, Pursuit, WayBack
from tricycle_bridge.commands.kinematics import TurningGeometry
from tricycle_bringup.configuration import driver_parameters, turning_geometry
from tricycle_core.errors import PlanError
from tricycle_sim.vehicle import draw_truth, load_vehicle


@pytest.fixture(scope="module")
def benchmark():
    return load_benchmark("way_back")


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 5, 13, 93])
def test_a_return_ends_within_5_cm_and_1_deg(benchmark, seed):
    vehicle, rng = load_vehicle(), np.random.default_rng(seed)
    true = vehicle.replace(**draw_truth(vehicle, rng))
    footprint = footprint_of(vehicle)
    start, goal = (benchmark.random_pose(rng, benchmark.YARD, footprint) for _ in range(2))
    end = benchmark.go_back(true, start, goal, seed)
    assert end.reason == ""
    assert end.off < 0.05
    assert end.turned < math.radians(1.0)


@pytest.mark.slow
def test_who_has_no_room_stays_where_it_is(benchmark):
    alley = Area(np.array([[0.0, 0.0], [25.0, 0.0], [25.0, 3.0], [0.0, 3.0]]))
    end = benchmark.go_back(load_vehicle(), (6.0, 1.5, 0.0), (15.0, 1.5, math.pi), 0, alley)
    assert end.reason.startswith("no way back to the start")
    assert end.off == pytest.approx(9.0, abs=0.05)


def test_the_defaults_are_those_of_the_packaged_tricycle():
    chassis, parameters = Chassis(), driver_parameters("")
    assert chassis.tyre_radius == parameters["tyre_radius"]
    assert chassis.unsteered_axle == pytest.approx(parameters["unsteered_axle"], abs=1e-3)
    assert chassis.geometry.wheelbase == pytest.approx(turning_geometry(load_vehicle()).wheelbase)


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_a_deviation_dies_out_forwards_and_backwards(sense):
    """On a vehicle that turns without slip, at once as commanded."""
    pursuit = Pursuit((Arc((0.0, 0.0, 0.0), 0.1, sense * 12.0),), Chassis())
    x, y, heading, now, speed = 0.0, 0.2, 0.1, 0.0, 0.0
    while not pursuit.done:
        angle, speed = pursuit.step((x, y, heading), now, rests=speed == 0.0)
        turn = pursuit.chassis.geometry.turn_rate(speed, angle)
        x, y = x + 0.01 * speed * math.cos(heading), y + 0.01 * speed * math.sin(heading)
        heading, now = heading + 0.01 * turn, now + 0.01
    np.testing.assert_allclose((x, y, heading), pursuit.arcs[0].end, atol=0.02)


def test_who_is_far_off_is_stopped():
    pursuit = Pursuit((Arc((0.0, 0.0, 0.0), 0.0, 5.0),), Chassis())

    def drive():
        for tick in range(200):
            pursuit.step((0.0, 0.6, 0.0), 0.01 * tick, rests=True)

    with pytest.raises(PlanError, match=r"0.60 m off the way back"):
        drive()


@pytest.mark.parametrize("road", [(0.0, 0.5), (0.1, 0.5), (-0.5, -0.1)])
def test_a_steering_to_one_side_only_has_no_arcs(road):
    with pytest.raises(PlanError, match=r"road_angles from .* to both sides of 0"):
        Chassis(TurningGeometry(motor_angles=road, road_angles=road))


def test_who_is_blocked_is_stopped():
    pursuit, rng = Pursuit((Arc((0.0, 0.0, 0.0), 0.0, 5.0),), Chassis()), np.random.default_rng(0)

    def drive():
        for tick in range(1000):
            x, y = 0.002 * rng.standard_normal(2)
            pursuit.step((x, y, 0.0), 0.01 * tick, rests=True)

    with pytest.raises(PlanError, match=r"driven but has not moved for 5 s"):
        drive()


@pytest.mark.parametrize(
    ("pose", "arrives"),
    [
        ((0.02, 0.0, math.radians(0.4)), True),
        ((0.0, 0.0, math.radians(0.8)), False),  # the start allows 1 deg, the noise some of it
        ((0.0, 0.0, math.radians(-0.8)), False),
        ((0.0, 0.04, 0.0), False),
    ],
)
def test_who_rests_at_the_goal_has_arrived_unless_another_route_is_needed(pose, arrives):
    back = WayBack((0.0, 0.0, 0.0), Chassis())
    for tick in range(100):
        back.step(pose, 0.01 * tick, rests=True)
    assert back.arrived is arrives
    assert (back.wanted is None) is arrives


def test_who_misses_the_start_too_often_gives_up():
    back = WayBack((0.0, 0.0, 0.0), Chassis())

    def drive():
        for tick in range(10_000):
            back.step((0.3, 0.0, 0.0), 0.01 * tick, rests=True)
            if back.wanted is not None:
                back.follow(())

    with pytest.raises(PlanError, match=r"0.30 m and 0.0 deg off the start after 4 routes"):
        drive()
