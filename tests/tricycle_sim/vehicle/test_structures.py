"""Vehicles of every structure: what they do."""

import numpy as np
import pytest
import structures

from tricycle_sim.commands import Commands
from tricycle_sim.vehicle.batch import simulate
from tricycle_sim.vehicle.kinematics import steered_wheels
from tricycle_sim.vehicle.live import LiveVehicle

STRUCTURES = structures.STRUCTURES


@pytest.mark.slow  # compiles each structure
@pytest.mark.parametrize("name", STRUCTURES)
def test_a_vehicle_stands_drives_and_turns(name):
    vehicle = structures.vehicle_of(STRUCTURES[name])
    time = np.arange(0.0, 6.01, 0.02)
    trajectory = simulate(vehicle, Commands(time, 0.2 * (time > 3.0), np.minimum(time, 1.5)))
    at_rest = [load[0, 0] for load in trajectory.load.values()]
    assert at_rest == pytest.approx(vehicle.static_loads(), abs=2.0)
    assert list(trajectory.load) == [wheel.name for wheel in vehicle.wheels]
    assert trajectory.drive_speed[0, -1] * vehicle.driven_radius == pytest.approx(1.5, rel=0.02)
    assert trajectory.yaw_rate[0, -1] > 0.1  # to the left, also with the rear wheels
    state = LiveVehicle(vehicle).step(speed=0.5)
    assert len(state.wheel_speeds) == len(vehicle.wheels)


@pytest.mark.slow  # compiles
@pytest.mark.parametrize("name", STRUCTURES)
def test_every_linkage_has_the_caster_of_its_king_pins(name):
    """The horizontal wheel angle is that about the king-pin, its tangent by the caster's cosine."""
    upright, tilted = (
        steered_wheels(structures.vehicle_of(STRUCTURES[name], caster_angle=caster), 0.3)
        for caster in (0.0, 0.4)
    )
    for wheel, on_road in tilted.items():
        tangent = np.cos(0.4) * np.tan(upright[wheel].angle)
        assert np.tan(on_road.angle) == pytest.approx(tangent, abs=1e-12)


@pytest.mark.slow  # compiles
def test_every_constant_can_be_unknown_and_moves_each_sample_alone():
    unknown = {
        "front.cornering_stiffness": (800.0, 2000.0),
        "steering_offset": (-0.05, 0.05),
        "com_height": (0.3, 0.5),
        "rear.tyre_radius": (0.34, 0.37),
        "servo_natural_frequency": (10.0, 40.0),
        "caster_angle": (0.0, 0.3),
    }
    nominal = {"front.cornering_stiffness": 1000.0, "servo_natural_frequency": 25.0}
    vehicle = structures.vehicle_of(
        STRUCTURES["car"], unknown, com_height=0.45, steering_offset=0.0, **nominal
    )
    assert [*vehicle.unknown] == [*unknown]
    time = np.arange(0.0, 3.01, 0.02)
    commands = Commands(time, 0.3 * np.sin(2.0 * time), np.minimum(time, 1.5))
    low, high = np.array([*unknown.values()]).T
    points = low + (high - low) * np.random.default_rng(3).random((9, len(low)))
    together = simulate(vehicle, commands, points)
    for sample in (0, 8):
        alone = vehicle.replace(**dict(zip(unknown, points[sample].tolist(), strict=True)))
        expected = simulate(alone, commands).columns()
        for name, column in together.columns().items():
            found = column if name == "time" else column[sample]
            assert found == pytest.approx(np.ravel(expected[name]), abs=1e-5), name
    live = LiveVehicle(vehicle, parameters=points[0])
    for _ in range(200):
        state = live.step(steering=0.0, speed=1.0)
    assert np.sign(state.yaw_rate) == np.sign(points[0, 1])  # of the offset


@pytest.mark.slow  # compiles
@pytest.mark.parametrize(("name", "unknown"), [
    ("direct_torque", {"setpoint_torque": (8.0, 16.0), "servo_delay": (0.0, 0.1),
                       "servo_backlash": (0.0, 0.05)}),
    ("throttle_curve", {"throttle_full_setpoint": (3.0, 5.0), "throttle_torque_50": (4.0, 8.0)}),
])  # fmt: skip
def test_constants_of_actuators_move_each_sample_alone(name, unknown):
    vehicle = structures.vehicle_of(structures.WITHOUT_SPEED_LOOP[name], unknown)
    time = np.arange(0.0, 2.01, 0.02)
    commands = Commands(time, 0.3 * np.sin(4.0 * time), np.minimum(2.0 * time, 2.0))
    points = np.array([*unknown.values()]).T
    together = simulate(vehicle, commands, points)
    assert together.vx[0, -1] > 0.1
    for sample, point in enumerate(points.tolist()):
        alone = simulate(vehicle.replace(**dict(zip(unknown, point, strict=True))), commands)
        for column in ("x", "y", "yaw"):
            found = getattr(together, column)
            assert found[sample] == pytest.approx(getattr(alone, column)[0], abs=1e-9)
    assert not np.allclose(together.x[0], together.x[1])


@pytest.mark.slow
def test_a_stop_backwards_is_the_mirror_image_of_one_ahead():
    """Of a vehicle whose rear is as its front, with more to brake than the motor regenerates."""
    alike = {f"rear_{side}.x": -0.6 for side in ("left", "right")}
    vehicle = structures.vehicle_of(
        structures.ALL_WHEELS, drive_front_share=0.5, acceleration=3.0, **alike
    )
    ahead, back = (
        simulate(vehicle, Commands([0.0, 2.0, 4.0], np.zeros(3), [speed, 0.0, 0.0]))
        for speed in (2.0, -2.0)
    )
    assert ahead.motor_torque.min() == pytest.approx(-vehicle.regenerative_torque, rel=1e-3)
    for name in ("x", "vx", "pitch", "motor_torque", "drive_speed"):
        mirrored = -getattr(back, name)
        assert mirrored == pytest.approx(getattr(ahead, name), abs=1e-9), name
