"""The vehicles that come along: planned for, driven on emulated boards, and identified."""

import dataclasses
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from excitation_planner import Criterion
from excitation_planner.maneuver import family_by_name
from excitation_planner.planning import PlanRequest, plan_maneuver
from parameter_identification.drives.measured import Sensor
from parameter_identification.drives.simulated import SensedMotion, SensorNoise, measure
from parameter_identification.identification import identify
from tricycle_bridge.commands.command_stream import VehicleCommand
from tricycle_bringup.configuration import bridge_settings
from tricycle_cli.new_vehicle import from_answers
from tricycle_sim.commands import Commands
from tricycle_sim.rig.emulated import EmulatedRig
from tricycle_sim.rig.host import Host
from tricycle_sim.setpoints import command_rows
from tricycle_sim.vehicle import draw_truth, load_vehicle, warnings_about
from tricycle_sim.vehicle.batch import simulate
from tricycle_sim.vehicle.constants import constant_entries
from tricycle_sim.vehicle.stability import check_step

TARGETS = {
    "tricycle": "cornering_stiffness",
    "cargo_tadpole": "front.cornering_stiffness",
    "delta_tricycle": "front.cornering_stiffness",
    "car_1_10": "front.cornering_stiffness",
}
SENSORS = {
    Sensor.POSITION: SensorNoise(0.005),
    Sensor.HEADING: SensorNoise(0.005),
    Sensor.YAW_RATE: SensorNoise(0.005, rate=100.0),
    Sensor.WHEEL_SPEED: SensorNoise(0.02, rate=100.0),
}


def shipped(name):
    return load_vehicle(Path(str(resources.files("tricycle_sim") / f"{name}.yaml")))


def driven_on_boards(vehicle, commands):
    """The motion of a vehicle whose boards get the commands, after they have armed."""
    host = Host(rig := EmulatedRig(vehicle), bridge_settings(vehicle))
    host.arm()
    start, rows = rig.time, []

    def sense():
        s = rig.state
        rows.append((rig.time - start, s.x, s.y, s.yaw, s.yaw_rate, s.drive_speed))

    sense()
    for row in command_rows(commands):
        angle, speed = commands.steering_motor_angle[row], commands.speed[row]
        host.target = VehicleCommand(float(angle), float(speed))
        host.tick()
        assert rig.armed, host.log
        sense()
    time, x, y, heading, *rest = np.array(rows).T
    return SensedMotion(time, x, y, np.unwrap(heading), *rest)


@pytest.mark.slow  # this and the next ones compile each structure
@pytest.mark.parametrize("name", TARGETS)
def test_it_stands_on_all_wheels_and_is_not_too_stiff(name):
    vehicle = shipped(name)
    loads = vehicle.static_loads()
    assert min(loads) > 0.0
    assert sum(loads) == pytest.approx(vehicle.mass * vehicle.gravity)
    check_step(vehicle, 0.01)
    warned = [text.partition(":")[0] for text in warnings_about(vehicle)]
    assert warned == (["yaw_inertia", "yaw_inertia.range"] if name == "tricycle" else [])


@pytest.mark.parametrize("name", TARGETS)
def test_its_page_has_a_picture_of_it(name):
    docs = Path(__file__).parents[1] / "docs"
    figure = docs / "figures" / f"{name}.png"
    assert any(f"(figures/{name}.png)" in page.read_text() for page in docs.glob("vehicle-*.md"))
    title = f"{name}, hash {shipped(name).fingerprint}".encode()
    assert title in figure.read_bytes(), f"{figure} is stale: run `make reference`"


@pytest.mark.parametrize(
    ("axle", "mass", "b", "c", "d"),
    [("front", 0.847, 8.60, 0.841, 0.841), ("rear", 0.733, 11.55, 0.959, 0.855)],
)
def test_the_cars_tyres_are_those_of_its_authors(axle, mass, b, c, d):
    """Their axle gives D m g sin(C atan(B slip))."""
    car = shipped("car_1_10")
    wheel = car.of(f"{axle}_left")
    assert (wheel.shape_lateral, wheel.friction_coefficient) == (c, d)
    assert 2.0 * wheel.cornering_stiffness == pytest.approx(b * c * d * mass * 9.81, rel=0.005)
    loads = dict(zip([wheel.name for wheel in car.wheels], car.static_loads(), strict=True))
    assert 2.0 * loads[f"{axle}_left"] == pytest.approx(mass * 9.81, rel=0.002)


@pytest.mark.slow
@pytest.mark.parametrize("name", TARGETS)
def test_every_constant_may_be_unknown(name):
    """A sample drives as the vehicle whose known constant has that value."""
    known = dataclasses.replace(shipped(name), unknown={})
    entries = constant_entries(known.wheels, known.parts)
    time = np.arange(0.0, 1.5, 0.02)
    commands = Commands(time, 0.15 * np.sin(4.0 * time), np.minimum(0.8 * time, 0.6))
    for entry, value in known.values.items():
        if entries[entry].setting:
            continue
        other = 1.02 * value if value else 0.02
        if other > entries[entry].high:
            other = 0.98 * value
        vehicle = dataclasses.replace(known, unknown={entry: tuple(sorted((value, other)))})
        both = simulate(vehicle, commands, [[value], [other]])
        for row, alone in enumerate((known, known.replace(**{entry: other}))):
            expected = simulate(alone, commands)
            for column in ("x", "y", "yaw", "roll"):
                found = getattr(both, column)[row, -1]
                assert found == pytest.approx(getattr(expected, column)[0, -1], abs=1e-9), entry


def plan_drive_and_identify(vehicle, target):
    """On emulated boards; estimates within 4 sigma, the target within 5 % of its range."""
    rng = np.random.default_rng(1)
    family = family_by_name("step-steer")
    request = PlanRequest(vehicle, family, target, criterion=Criterion.C, budget=4000)
    plan = plan_maneuver(request)
    truth = draw_truth(vehicle, rng)
    motion = driven_on_boards(vehicle.replace(**truth), plan.commands)
    drive = measure(motion, plan.commands, SENSORS, rng=rng)
    found = identify([drive], vehicle)
    low, high = np.array(list(vehicle.unknown.values())).T
    off = np.abs(found.estimates - list(truth.values()))
    assert np.all(off < 4.0 * found.standard_deviations)
    at = list(vehicle.unknown).index(target)
    assert found.standard_deviations[at] < 0.05 * (high - low)[at]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "target"), TARGETS.items())
def test_it_is_planned_for_driven_on_emulated_boards_and_identified(name, target):
    plan_drive_and_identify(shipped(name), target)


@pytest.mark.slow
def test_a_new_vehicle_is_one_yaml_and_no_code(tmp_path):
    """No shipped vehicle is like it: driven in front, steered behind, a law for each axle."""
    answers = {
        "name": "dumper", "layout": "car", "steered": "rear", "driven": "front",
        "steering": "ackermann", "front.tyre": "fiala", "rear.tyre": "magic_formula",
        "servo": "geared", "servo_delay": 0.02, "servo_backlash": 0.5, "motor": "hub_motor",
        "mass": 60.0, "wheelbase": 1.2, "front_track": 0.7, "rear_track": 0.6, "front_share": 60.0,
        "com_height": 0.35, "tyre_radius": 0.2, "steering_limit": 40.0, "top_speed": 4.0,
        "motor_torque": 25.0, "battery_voltage": 48.0,
    }  # fmt: skip
    file = tmp_path / "dumper.yaml"
    file.write_text(from_answers(answers))
    plan_drive_and_identify(load_vehicle(file), "rear.cornering_stiffness")
