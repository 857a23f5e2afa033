"""The tube holds vehicles that it was not made of, also when they are stopped on the way."""

import numpy as np
import pytest
import shapely

from excitation_planner.area import tube as tubes
from excitation_planner.area.stops import longest_stop, stopping_path
from excitation_planner.area.tube import BEYOND, footprint_of, tube_of
from excitation_planner.maneuver import family_by_name
from excitation_planner.maneuver.steering import SineSweep
from excitation_planner.planning.replay import nominal_run
from tricycle_core.errors import InfeasibleManeuver
from tricycle_core.poses import placed
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import CommandedBatch, simulate


@pytest.mark.slow
@pytest.mark.parametrize(("name", "x"), [("circle", [3.0, 0.8]), ("double-lane-change", None)])
def test_other_vehicles_of_the_ranges_stay_inside_driving_and_stopped(name, x) -> None:
    vehicle, family = load_vehicle(), family_by_name(name)
    point = np.array(family.operation.high) if x is None else np.array(x)
    commands = nominal_run(vehicle, family, point).commands
    footprint = footprint_of(vehicle)
    tube = tube_of(vehicle, commands, footprint)
    assert tube.whole.area > tube.drive.area
    rng = np.random.default_rng(7)
    low, high = np.array(list(vehicle.unknown.values())).T
    parameters = rng.uniform(low, high, (20, len(low)))
    _inside(tube.drive, simulate(vehicle, commands, parameters), footprint)
    for at in (0.3, 0.6, 0.9):  # standstill commanded, as by the fence; the steering is held
        row = int(at * len(commands.time))
        stopped = Commands(
            np.append(commands.time[:row], commands.time[row] + np.array([0.0, 4.0])),
            np.append(
                commands.steering_motor_angle[:row], commands.steering_motor_angle[[row] * 2]
            ),
            np.append(commands.speed[:row], [0.0, 0.0]),
        )
        _inside(tube.whole, simulate(vehicle, stopped, parameters), footprint)


@pytest.mark.slow
def test_a_rough_tube_is_a_part_of_the_tube() -> None:
    vehicle, family = load_vehicle(), family_by_name("slalom")
    commands = nominal_run(vehicle, family, np.array([5.0, 0.8])).commands
    whole = tube_of(vehicle, commands, footprint_of(vehicle)).whole
    rough = tube_of(vehicle, commands, footprint_of(vehicle), rough=True).whole
    assert rough.difference(whole.buffer(BEYOND)).area == 0.0
    assert rough.area > 0.6 * whole.area


def _inside(polygon, motion, footprint) -> None:
    every = round(0.2 / TICK)
    poses = (motion.x[:, ::every], motion.y[:, ::every], motion.yaw[:, ::every])
    footprints = shapely.polygons(placed(footprint, *poses).reshape(-1, len(footprint), 2))
    outside = shapely.area(shapely.difference(footprints, polygon))
    assert outside.max() == 0.0, f"{outside.max()} m^2 outside"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sine-sweep", "slalom", "step-steer"])
def test_stops_between_the_times_that_are_looked_at_end_inside(name) -> None:
    """Where the steering is fast, the ends of stops 0.3 s apart are metres apart."""
    vehicle, family = load_vehicle(), family_by_name(name)
    low, high = (np.array(end) for end in (family.operation.low, family.operation.high))
    commands = nominal_run(vehicle, family, 0.5 * (low + high)).commands
    footprint = footprint_of(vehicle)
    drawn = tubes._vehicles(vehicle)
    run = CommandedBatch(vehicle, commands).run(
        drawn, ("x", "y", "yaw", "vx", "vy", "yaw_rate"), every=2
    )
    x, y, yaw, u, v, rate = run.columns.values()
    speed = np.hypot(u, v)
    way = np.where(speed > tubes.SLOWEST, longest_stop(speed), 0.0)
    curvature = rate / np.maximum(speed, tubes.SLOWEST)
    at_rest = stopping_path(x, y, yaw, np.arctan2(v, u), way, curvature, points=2)
    corners = placed(footprint, *at_rest)[:, :, -1].reshape(-1, 2)
    whole = tube_of(vehicle, commands, footprint).whole
    assert shapely.distance(shapely.points(corners), whole).max() < 0.02


def test_a_maneuver_in_which_a_vehicle_of_the_ranges_lifts_a_wheel_keeps_no_load() -> None:
    vehicle = load_vehicle()
    gentle, rough = (
        SineSweep(turn=0.6).drive(np.array([amplitude, 2.0]), vehicle) for amplitude in (0.1, 0.15)
    )
    footprint = footprint_of(vehicle)
    assert tube_of(vehicle, gentle, footprint, kept_load=0.03).whole.area > 0.0
    assert tube_of(vehicle, rough, footprint).whole.area > 0.0
    with pytest.raises(InfeasibleManeuver, match="a wheel carries 0 N, 5 N are kept"):
        tube_of(vehicle, rough, footprint, kept_load=0.03)
