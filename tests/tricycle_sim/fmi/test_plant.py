"""An FMU behind the boards."""

import math
import shutil
import tempfile
from pathlib import Path

import pytest

from tricycle_bridge.commands.command_stream import VehicleCommand
from tricycle_core.errors import PlantError
from tricycle_sim.fmi.mapping import load_mapping
from tricycle_sim.plants.installed import plant_by_name
from tricycle_sim.plants.own import OwnPlant
from tricycle_sim.rig.emulated import EmulatedRig
from tricycle_sim.rig.host import Host
from tricycle_sim.vehicle import load_vehicle

pytest.importorskip("fmpy")
pytestmark = pytest.mark.slow
VEHICLE = load_vehicle()
STEERING = ("steering_motor_angle", "steering_motor_rate")
LEAN = dict.fromkeys([*STEERING, "vx", "vy", "yaw_rate", "ax", "ay", "drive_speed", "motor_torque"])


def plant(file):
    from tricycle_sim.plants.fmu_plant import fmu_plant

    return fmu_plant(VEHICLE, 0, file)


def driven(one):
    rig = EmulatedRig(VEHICLE, plant=one)
    host = Host(rig)
    host.arm()
    host.target = VehicleCommand(0.2, 2.0)
    host.run(4.0)
    moved = rig.state
    host.target = None  # the watchdogs stop it
    host.run(4.0)
    return moved, rig.state


def test_our_vehicle_as_an_fmu_drives_as_itself(mapping_file):
    (moved, stopped), (own, own_stopped) = driven(plant(mapping_file())), driven(OwnPlant(VEHICLE))
    for name in ("x", "y", "yaw", "vx", "yaw_rate", "drive_angle"):
        # two Runge-Kutta steps per tick live, one in the FMU
        assert getattr(moved, name) == pytest.approx(getattr(own, name), rel=1e-4, abs=1e-6), name
    assert stopped.x == pytest.approx(own_stopped.x, abs=2e-3)  # it rocks on its tyres
    assert stopped.vx == pytest.approx(0.0, abs=0.02)


def test_what_an_fmu_does_not_tell_follows_from_its_poses(mapping_file):
    moved, stopped = driven(plant(mapping_file(outputs=LEAN)))
    own, _ = driven(OwnPlant(VEHICLE))
    assert math.hypot(moved.x - own.x, moved.y - own.y) < 0.05
    assert moved.yaw_rate == pytest.approx(own.yaw_rate, rel=0.02)
    assert moved.specific_force[1] == pytest.approx(own.specific_force[1], rel=0.05)
    assert stopped.vx == pytest.approx(0.0, abs=1e-2)


def test_the_angle_of_the_wheels_is_what_the_fmu_tells(mapping_file):
    doubled = {"drive_angle": {"variable": "drive_angle", "scale": 2.0}}
    plain, other = plant(mapping_file()), plant(mapping_file(outputs=doubled))
    for tick in range(100):
        states = [one.hold_speed(tick, 0.0, 1.0, 0.0) for one in (plain, other)]
    assert states[1].drive_angle == pytest.approx(2.0 * states[0].drive_angle, rel=1e-9)
    plain.close()
    other.close()


def test_it_starts_where_it_is_placed(mapping_file):
    one = plant(mapping_file())
    state = one.place((1.0, -2.0, 0.5))
    assert (state.x, state.y, state.yaw) == pytest.approx((1.0, -2.0, 0.5))
    for tick in range(300):
        state = one.hold_speed(tick, 0.0, 1.0, 0.0)
    heading = math.atan2(state.y + 2.0, state.x - 1.0)
    assert heading == pytest.approx(0.5, abs=1e-3)
    one.close()


def test_an_fmu_that_refuses_a_step_is_one_line(mapping_file):
    one = plant(mapping_file(step=0.005))
    with pytest.raises(PlantError, match=r"tricycle\.fmu: fails at 0\.00 s") as problem:
        one.advance(0, 0.0, 0.0, 0.0)
    assert str(problem.value).endswith("(fmi2DoStep: needs steps of a multiple of 0.01 s)")
    assert "\n" not in str(problem.value)


def test_a_number_that_is_none_is_one_line(mapping_file, monkeypatch):
    one = plant(mapping_file())
    monkeypatch.setattr(
        one._instance._slave, "getReal", lambda references: [math.nan] * len(references)
    )
    with pytest.raises(PlantError, match=r"is nan at 0\.01 s"):
        one.advance(0, 0.0, 0.0, 0.0)


def test_an_fmu_that_cannot_be_placed_anew_goes_on(mapping_file):
    one = plant(mapping_file())
    for tick in range(100):
        before = one.hold_speed(tick, 0.0, 1.0, 0.0)
    unpacked = Path(one._fmu._folder)
    shutil.rmtree(unpacked)
    with pytest.raises(PlantError, match=r"tricycle\.fmu: does not start"):
        one.place((0.0, 0.0, 0.0))
    assert one.hold_speed(100, 0.0, 1.0, 0.0).x > before.x
    one.close()


def test_a_library_that_does_not_load_leaves_the_working_folder(mapping_file):
    from tricycle_sim.fmi.cosimulation import Fmu

    fmu, folder = Fmu(load_mapping(mapping_file())), Path.cwd()
    for library in Path(fmu._folder).rglob("*.so"):
        library.write_text("no library")
    with pytest.raises(PlantError, match=r"tricycle\.fmu: does not start: Failed to load"):
        fmu.start()
    fmu.close()
    assert Path.cwd() == folder


def test_an_fmu_of_which_a_process_has_one_ends_before_it_starts_anew(mapping_file, monkeypatch):
    one = plant(mapping_file())
    one._fmu.only_once = True
    old = one._instance
    start = one._fmu.start

    def start_alone(parameters):
        assert old._slave is None
        return start(parameters)

    monkeypatch.setattr(one._fmu, "start", start_alone)
    one.place((1.0, 0.0, 0.0))
    assert one.hold_speed(0, 0.0, 0.0, 0.0).x == pytest.approx(1.0)
    one.close()


def test_an_fmu_that_has_ended_tells_it_and_can_be_closed_again(mapping_file):
    one = plant(mapping_file())
    one.close()
    one.close()
    with pytest.raises(PlantError, match=r"tricycle\.fmu: has ended"):
        one.advance(0, 0.0, 0.0, 0.0)


def test_a_start_that_fails_leaves_nothing_unpacked(mapping_file, monkeypatch, tmp_path):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with monkeypatch.context() as patched:
        patched.setattr(
            "tricycle_sim.fmi.cosimulation.Instance.read", lambda _: {}["another mistake"]
        )
        with pytest.raises(KeyError):
            plant(mapping_file())
    assert not list(tmp_path.glob("fmu-*"))


@pytest.mark.parametrize("without", [(), ("torque", "torque_mode"), ("speed",)])
def test_an_emergency_stop_stops_it_with_every_set_of_inputs(mapping_file, without):
    one = plant(mapping_file(inputs=dict.fromkeys(without)))
    for tick in range(300):
        if "speed" in without:
            state = one.advance(tick, 0.0, 10.0, 0.0)
        else:
            state = one.hold_speed(tick, 0.0, min(2.0, 0.01 * tick), 0.0)
    assert state.vx > 1.0
    for tick in range(300, 700):
        state = one.advance(tick, 0.0, 0.0, 1.0)
    assert state.vx == pytest.approx(0.0, abs=0.02)
    one.close()


@pytest.mark.parametrize(
    ("changes", "line"),
    [
        ({"inputs": {"steering": None}}, "inputs: a plant needs steering"),
        ({"inputs": {"speed": None, "torque": None}}, "inputs: a plant needs torque or speed"),
        ({"inputs": {"torque_mode": None}}, "inputs: speed and torque together need torque_mode"),
        ({"outputs": {"heading": None}}, "outputs: a plant needs heading"),
        ({"step": 0.003}, "step: 0.003 s does not divide 0.01 s"),
        ({"parameters": {"weight": "mass"}}, r"parameters\.weight: tricycle has no such constant"),
    ],
)
def test_a_mapping_that_makes_no_plant_is_one_line(mapping_file, changes, line):
    with pytest.raises(PlantError, match=line):
        plant(mapping_file(**changes))


def test_without_a_mapping_it_is_one_line():
    from tricycle_sim.plants.fmu_plant import fmu_plant

    with pytest.raises(PlantError, match="needs its mapping file"):
        fmu_plant(VEHICLE)


def test_its_name_carries_the_mapping(mapping_file, install_distribution):
    points = {"fmu-of-test": "tricycle_sim.plants.fmu_plant:fmu_plant"}
    install_distribution("tricycle_sim.plants", "fmus", "nothing", "", points)
    one = plant_by_name(f"fmu-of-test:{mapping_file()}", VEHICLE)
    assert one.hold_speed(0, 0.0, 0.0, 0.0).vx == pytest.approx(0.0, abs=1e-6)
    one.close()
    with pytest.raises(PlantError, match="needs its mapping file"):
        plant_by_name("fmu-of-test", VEHICLE)
