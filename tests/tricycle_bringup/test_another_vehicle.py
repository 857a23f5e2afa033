"""A vehicle of other measures than the packaged one, from its file to what it does."""

import pytest

from tricycle_bridge.commands.command_messages import twist_command
from tricycle_bridge.protocol.messages import Board
from tricycle_bridge.protocol.units import SPEED_UNIT
from tricycle_bringup.configuration import beyond_the_boards, bridge_settings, turning_geometry
from tricycle_core.errors import VehicleError
from tricycle_sim.rig.emulated import EmulatedRig
from tricycle_sim.rig.host import Host
from tricycle_sim.rig.native import NativeRig
from tricycle_sim.vehicle import load_vehicle

LONG = load_vehicle().replace(com_to_front_axle=1.1, com_to_rear_axle=0.9, tyre_radius=0.25)


@pytest.fixture(params=["emulated", "firmware"])
def rig(request):
    if request.param == "emulated":
        return EmulatedRig(LONG)
    return NativeRig(LONG, request.getfixturevalue("firmware_libraries"))


def drive(rig, vehicle, speed, turn_rate, seconds):
    """Drive a Twist; return the host."""
    settings = bridge_settings(vehicle)
    host = Host(rig, settings)
    host.arm()
    host.target = twist_command(
        speed, turn_rate, settings, turning_geometry(vehicle), resting_angle=0.0
    )
    host.run(seconds)
    return host


@pytest.mark.slow
def test_cmd_vel_turns_it_as_fast_as_it_says(rig):
    drive(rig, LONG, 1.0, -0.25, 5.0)
    assert rig.state.yaw_rate == pytest.approx(-0.25, rel=0.04)


def test_hall_pulses_tell_its_speed_and_travel(rig):
    host = drive(rig, LONG, 1.0, 0.0, 4.0)
    telemetry = host.bridge.links[Board.DRIVE].telemetry
    assert rig.state.vx == pytest.approx(1.0, rel=0.03)  # the tyre is a little flat below
    assert telemetry.speed * SPEED_UNIT == pytest.approx(1.0, rel=0.01)
    travel = telemetry.hall_count * bridge_settings(LONG).hall_pulse
    assert travel == pytest.approx(rig.state.drive_angle * LONG.driven_radius, abs=0.03)


def test_a_bridge_that_was_told_of_another_wheel_shows_it():
    """Told of 0.335 m, it takes every pulse of the 0.25 m wheel for a third more travel."""
    rig = EmulatedRig(LONG)
    drive(rig, load_vehicle(), 1.0, 0.0, 4.0)
    assert rig.state.vx == pytest.approx(0.25 / 0.335, rel=0.03)


def test_what_the_boards_cannot_drive_is_named():
    quick = LONG.replace(steering_slew=4.0)
    with pytest.raises(VehicleError, match=r"cannot drive it: max_steering_rate = 4 is outside"):
        bridge_settings(quick)


def test_of_a_stronger_motor_the_boards_use_what_they_can():
    strong = LONG.replace(motor_torque=60.0)
    assert bridge_settings(strong).motor_torque == 35.0
    assert beyond_the_boards(strong) == ("motor_torque: 60 N m, of which the boards use 35",)


def test_a_motor_that_the_firmware_does_not_know_is_named():
    assert beyond_the_boards(LONG.replace(motor_no_load_speed=17.0)) == (
        "motor_no_load_speed: 17 rad/s; the firmware has 15.5",
    )
