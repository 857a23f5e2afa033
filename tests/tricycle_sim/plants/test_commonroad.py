"""CommonRoad's multi-body car, driven by the emulated boards."""

import sys
from importlib.resources import files

import pytest

from tricycle_bridge.commands.command_stream import VehicleCommand
from tricycle_bringup.configuration import bridge_settings
from tricycle_core.errors import PlantError
from tricycle_sim.plants.installed import plant_by_name
from tricycle_sim.rig.emulated import EmulatedRig
from tricycle_sim.rig.host import Host
from tricycle_sim.vehicle import load_vehicle, warnings_about
from tricycle_sim.vehicle.kinematics import curvature, steered_wheels

pytest.importorskip("vehiclemodels")
BMW = load_vehicle(files("tricycle_sim") / "plants" / "bmw_320i.yaml")


def armed(plant="commonroad"):
    rig = EmulatedRig(BMW, plant=plant_by_name(plant, BMW))
    host = Host(rig, bridge_settings(BMW))
    host.arm()
    return rig, host


def test_its_vehicle_file_is_plausible():
    assert list(warnings_about(BMW)) == []


@pytest.mark.slow
def test_it_turns_as_its_wheels_point_and_stops_for_good():
    rig, host = armed()
    host.target = VehicleCommand(0.2, 1.0)
    host.run(5.0)
    state = rig.state
    assert rig.armed, host.log
    assert state.vx == pytest.approx(1.0, abs=0.01)
    turn = curvature(list(steered_wheels(BMW, 0.2).values()))
    assert state.yaw_rate / state.vx == pytest.approx(turn, rel=0.03)
    assert state.drive_angle * BMW.driven_radius == pytest.approx(4.5, abs=0.2)
    assert state.specific_force[1] == pytest.approx(state.yaw_rate * state.vx, rel=0.05)
    host.target = None  # the watchdogs stop it
    host.run(4.0)
    assert not rig.armed
    assert rig.state.vx == pytest.approx(0.0, abs=1e-9)


@pytest.mark.slow
def test_fast_turns_are_wider_as_its_tyres_slip():
    turns = []
    for speed in (1.0, 4.0):
        rig, host = armed()
        host.target = VehicleCommand(0.2, speed)
        host.run(7.0)
        turns.append((rig.state.vy - BMW.com_to_rear_axle * rig.state.yaw_rate) / rig.state.vx)
    assert turns[1] < turns[0] - 0.005  # the slip angle behind


def test_a_vehicle_file_of_another_vehicle_is_one_line():
    with pytest.raises(PlantError, match=r"tricycle: tyre_radius: 0\.335 must be about 0\.344"):
        plant_by_name("commonroad", load_vehicle())


def test_without_the_library_it_is_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "vehiclemodels.init_mb", None)
    monkeypatch.setitem(sys.modules, "vehiclemodels", None)
    monkeypatch.delitem(sys.modules, "tricycle_sim.plants.commonroad_plant", raising=False)
    with pytest.raises(PlantError, match=r"pip install 'tricycle-excitation\[commonroad\]'"):
        plant_by_name("commonroad", BMW)
