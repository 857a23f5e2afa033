"""The vehicle as rigid bodies in MuJoCo: its weight, its turns, its stops, its energy."""

import dataclasses
import subprocess
import sys
from importlib.resources import files

import numpy as np
import pytest

from tricycle_bridge.commands.command_stream import VehicleCommand
from tricycle_core.errors import PlantError
from tricycle_sim.effects import extend
from tricycle_sim.plants.installed import plant_by_name
from tricycle_sim.plants.own import OwnPlant
from tricycle_sim.rig.emulated import EmulatedRig
from tricycle_sim.rig.host import Host
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.kinematics import curvature, steered_wheels

pytest.importorskip("mujoco")
FILES = sorted(path.name for path in files("tricycle_sim").iterdir() if path.suffix == ".yaml")
VEHICLE = load_vehicle()


def plant_of(vehicle):
    return plant_by_name("mujoco", vehicle)


def armed(vehicle=VEHICLE):
    rig = EmulatedRig(vehicle, plant=plant_of(vehicle))
    host = Host(rig)
    host.arm()
    return rig, host


@pytest.mark.parametrize("name", FILES)
def test_at_rest_each_wheel_carries_its_share_of_the_weight(name):
    vehicle = load_vehicle(files("tricycle_sim") / name)
    state = plant_of(vehicle).place((3.0, -1.0, 0.5))
    assert state.loads == pytest.approx(vehicle.static_loads(), rel=0.01)
    assert (state.x, state.y) == (3.0, -1.0)
    assert state.yaw == pytest.approx(0.5, abs=1e-4)
    assert state.z == pytest.approx(plant_by_name("own", vehicle).place((0, 0, 0)).z, rel=0.01)
    assert state.specific_force == pytest.approx((0.0, 0.0, vehicle.gravity), abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("angle", [-0.4, 0.15])
def test_at_walking_pace_it_turns_as_its_wheels_point(angle):
    rig, host = armed()
    host.target = VehicleCommand(angle, 0.5)
    host.run(4.0)
    assert rig.armed, host.log
    turn = curvature(list(steered_wheels(VEHICLE, angle).values()))
    assert rig.state.yaw_rate / rig.state.vx == pytest.approx(turn, rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("speed", [1.0, 2.0])
def test_a_wheel_slips_in_proportion_to_its_force_at_any_speed(speed):
    uphill = VEHICLE.replace(road_grade=0.05)
    rig, host = armed(uphill)
    host.target = VehicleCommand(0.0, speed)
    host.run(6.0)
    loaded = VEHICLE.driven_radius - rig.state.loads[2] / VEHICLE.vertical_stiffness
    slip = rig.state.drive_speed * loaded - rig.state.vx
    force = uphill.mass * uphill.gravity * np.sin(0.05)
    force += uphill.rolling_coefficient_1 * sum(rig.state.loads[:2])  # of the front wheels
    assert slip == pytest.approx(force / uphill.cornering_stiffness, rel=0.05)


@pytest.mark.slow
def test_our_model_weaves_alike_with_tyres_of_its_law():
    """Nothing turns later, and nothing is heavier than the vehicle file says."""
    known = dataclasses.replace(VEHICLE, unknown={})
    alike = extend(known, {"tyre": "softened"}).replace(
        slip_by_speed=1.0,
        lateral_relaxation_length=0.004,
        air_drag=0.0,
        camber_stiffness=0.0,
        self_aligning_stiffness=0.0,
    )
    turns = []
    for plant in (plant_of(VEHICLE), OwnPlant(alike)):
        rig = EmulatedRig(VEHICLE, plant=plant)
        host = Host(rig)
        host.arm()
        turns.append([])
        for tick in range(600):
            host.target = VehicleCommand(0.15 * np.sin(0.04 * tick), 1.5)
            host.tick()
            turns[-1].append(rig.state.yaw_rate)
    theirs, ours = np.array(turns)[:, 300:]
    assert np.std(theirs) > 0.05
    assert np.std(theirs - ours) < 0.005 * np.std(theirs)


@pytest.mark.slow
def test_a_wheel_that_slides_keeps_its_weight():
    slippery = VEHICLE.replace(friction_coefficient=0.2)
    loads = []
    for plant in (plant_of(slippery), OwnPlant(slippery)):
        rig = EmulatedRig(VEHICLE, plant=plant)
        host = Host(rig)
        host.arm()
        host.target = VehicleCommand(0.35, 1.8)
        loads.append([])
        for _ in range(400):
            host.tick()
            loads[-1].append(rig.state.loads)
    sliding, own = np.array(loads)[:, 200:]
    assert sliding.min() > 0.7 * own.min() > 40.0


@pytest.mark.slow
def test_it_stops_and_stays_when_it_is_told_to_and_when_the_host_falls_silent():
    rig, host = armed()
    host.target = VehicleCommand(0.0, 1.5)
    host.run(3.0)
    assert rig.state.vx == pytest.approx(1.5, abs=0.2)
    host.target = VehicleCommand(0.0, 0.0)
    host.run(4.0)
    assert abs(rig.state.vx) < 1e-3
    host.target = VehicleCommand(0.0, 1.0)
    host.run(2.0)
    host.kill()
    host.run(3.0)
    assert not rig.armed
    where = rig.state.x
    host.run(1.0)
    assert rig.state.x == pytest.approx(where, abs=1e-4)


@pytest.mark.slow
def test_without_motor_and_brake_it_loses_energy_by_its_rolling_resistance_alone():
    rig, host = armed()
    host.target = VehicleCommand(0.0, 2.0)
    host.run(4.0)
    plant = rig._plant
    speeds = [plant.advance(k, 0.0, 0.0, 0.0).vx for k in range(300)][100:]
    each = [VEHICLE.of(wheel) for wheel in VEHICLE.wheels]
    inertia = VEHICLE.mass + sum(own.wheel_inertia / own.tyre_radius**2 for own in each)
    loss = VEHICLE.rolling_coefficient_1 * VEHICLE.mass * VEHICLE.gravity
    assert np.all(np.diff(speeds) < 0.0)
    assert (speeds[0] - speeds[-1]) / 1.99 == pytest.approx(loss / inertia, rel=0.05)


def test_what_has_rolled_over_lies_where_it_is():
    plant = plant_of(VEHICLE)
    data = plant.scene[1]
    data.qvel[[0, 3]] = 2.0, 6.0  # forward and in roll
    state = plant.advance(0, 0.0, 5.0, 0.0)
    for tick in range(1, 200):
        before, state = state, plant.advance(tick, 0.0, 5.0, 0.0)
        if state.rolled_over:
            break
    assert before.vx > 1.0
    for _ in range(3):
        assert state.rolled_over
        assert (state.vx, state.vy, state.vz) == (0.0, 0.0, 0.0)
        assert (state.roll_rate, state.pitch_rate, state.yaw_rate) == (0.0, 0.0, 0.0)
        assert (state.drive_speed, state.motor_torque, state.motor_current) == (0.0, 0.0, 0.0)
        x, roll = state.x, state.roll
        state = plant.advance(tick, 0.0, 5.0, 0.0)
        assert (state.x, state.roll) == (x, roll)


@pytest.mark.slow
def test_a_drive_is_the_same_every_time():
    ends = []
    for _ in range(2):
        rig, host = armed()
        host.target = VehicleCommand(0.3, 1.0)
        host.run(1.0)
        ends.append(rig.state)
    assert ends[0] == ends[1]


@pytest.mark.slow
def test_mujoco_is_imported_for_its_plant_only():
    code = (
        "import sys, tricycle_sim.sim_node\n"
        "from tricycle_sim.plants.installed import plant_names\n"
        "assert 'mujoco' in plant_names()\n"
        "sys.exit('mujoco' in sys.modules or 'vehiclemodels' in sys.modules)"
    )
    pytest.importorskip("rclpy")
    subprocess.run([sys.executable, "-c", code], check=True)


def test_without_the_library_it_is_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    monkeypatch.delitem(sys.modules, "tricycle_sim.plants.mujoco_plant", raising=False)
    with pytest.raises(PlantError, match=r"pip install 'tricycle-excitation\[mujoco\]'"):
        plant_of(VEHICLE)


def test_wheels_too_heavy_for_the_body_are_one_line():
    heavy = VEHICLE.replace(rear_wheel_inertia=6.0)
    with pytest.raises(PlantError, match="rings with the inertia of its wheels outweigh the mass"):
        plant_of(heavy)
