"""The bridge's rules against both emulated PLCs, on a simulated clock."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tricycle_bridge.command_stream import Source, VehicleCommand
from tricycle_bridge.protocol.messages import Board, Fault, PlcState
from tricycle_sim.plc import SteerMeasurement

STEER, DRIVE = Board.STEER, Board.DRIVE


def test_nothing_arms_without_the_operator(vehicle):
    vehicle.step(500)
    assert not vehicle.bridge.armed
    assert {p.state for p in vehicle.plcs.values()} == {PlcState.SAFE}


def test_arming_and_driving(driving):
    assert driving.bridge.armed
    assert driving.arm() == (True, "already armed")


def test_a_commander_that_stops_is_not_replaced(driving):
    driving.target = None
    driving.step(12)
    sent = dict(driving.commands)
    driving.step(300)
    assert driving.commands == sent
    assert driving.state(DRIVE) is PlcState.SAFE
    assert driving.plcs[DRIVE].faults & Fault.CMD_TIMEOUT
    assert driving.measured[DRIVE].speed == 0.0
    driving.target = (0.2, 1.0)
    driving.step(300)
    assert driving.state(DRIVE) is PlcState.SAFE  # only the operator arms


@pytest.mark.parametrize("lost", [STEER, DRIVE])
def test_losing_one_board_stops_the_other_without_a_fault(driving, lost):
    other = DRIVE if lost is STEER else STEER
    driving.cut.add(lost)
    driving.step(40)
    assert driving.state(other) is PlcState.STOPPING
    driving.step(200)
    assert [p.state for p in driving.plcs.values()] == [PlcState.SAFE] * 2
    assert driving.plcs[other].faults == 0
    assert driving.plcs[lost].faults == Fault.CMD_TIMEOUT


@pytest.mark.parametrize("board", [STEER, DRIVE])
def test_a_reboot_in_mid_drive_stops_the_other_and_needs_the_operator(driving, board):
    driving.plcs[board].reset()
    driving.step(300)
    assert [p.state for p in driving.plcs.values()] == [PlcState.SAFE] * 2
    assert any("rebooted" in text for text in driving.warnings)
    driving.target = (0.2, 0.0)
    driving.step()
    assert driving.arm() == (True, "armed")


def test_an_estop_of_one_board_stops_both(driving):
    driving.measured[STEER] = SteerMeasurement(0.2, estop_pressed=True)
    driving.step(200)
    assert driving.state(STEER) is PlcState.ESTOP
    assert driving.state(DRIVE) is PlcState.SAFE
    assert driving.measured[DRIVE].speed == 0.0


def test_the_operators_estop_latches_until_the_next_arm(driving):
    driving.bridge.emergency_stop(driving.now)
    driving.step(2)
    assert [p.state for p in driving.plcs.values()] == [PlcState.ESTOP] * 2
    for plc in driving.plcs.values():
        assert plc.faults & Fault.ESTOP_HOST
    driving.target = (0.0, 0.0)
    driving.step(100)
    assert driving.arm() == (True, "armed")


def test_disarm_takes_the_drive_away_at_once(driving):
    driving.bridge.disarm(driving.now)
    driving.step(2)
    assert [p.state for p in driving.plcs.values()] == [PlcState.SAFE] * 2


def test_stop_lets_the_vehicle_roll_out(driving):
    driving.bridge.stop("the bridge was deactivated")
    driving.bridge.active = False
    driving.step(2)
    assert [p.state for p in driving.plcs.values()] == [PlcState.STOPPING] * 2
    driving.step(200)
    assert driving.plcs[DRIVE].faults == 0


# ---- commands ----


def test_every_message_of_a_100_hz_commander_goes_out_at_once(vehicle):
    before = dict(vehicle.commands)
    vehicle.step(100)
    for board in (STEER, DRIVE):
        assert vehicle.commands[board] - before[board] == pytest.approx(100, abs=4)  # + requests


def test_a_message_is_repeated_at_the_command_rate_while_it_is_fresh(vehicle):
    vehicle.target = None
    before = dict(vehicle.commands)
    vehicle.step(100)
    for board in (STEER, DRIVE):
        assert vehicle.commands[board] - before[board] == pytest.approx(5, abs=1)


def test_a_commander_at_1_khz_does_not_overload_the_line(vehicle):
    frames = 0
    for k in range(1000):
        now = vehicle.now + k * 0.001
        vehicle.bridge.set_command(
            VehicleCommand(k * 1e-4, 0.0), stamp=now, now=now, source=Source.JOINT_COMMANDS
        )
        frames += len(vehicle.bridge.take_frames()[STEER])
    assert 90 <= frames <= 112


def test_joint_commands_win_over_cmd_vel(driving):
    refusal = driving.bridge.set_command(
        VehicleCommand(0.0, 0.0), stamp=driving.now, now=driving.now, source=Source.CMD_VEL
    )
    assert refusal == "cmd_vel ignored while joint_commands are coming"
    driving.step()
    assert driving.measured[DRIVE].speed == pytest.approx(1.0)


@settings(max_examples=50)
@given(st.floats(-1e300, 1e300), st.floats(-1e300, 1e300))
def test_no_finite_command_breaks_or_exceeds_anything(new_vehicle, angle, speed):
    vehicle = new_vehicle()
    assert vehicle.arm()[0]
    vehicle.target = (angle, speed)
    vehicle.step(3)
    assert abs(vehicle.measured[STEER].angle) <= 0.03 * 2.0 + 1e-9
    assert abs(vehicle.measured[DRIVE].speed) <= 0.03 * 1.0 + 1e-9


def test_reverse_is_a_gear(vehicle):
    vehicle.arm()
    vehicle.target = (0.0, -0.5)
    vehicle.step(100)
    assert vehicle.measured[DRIVE].speed == pytest.approx(-0.5)


# ---- what it reports ----


def test_joint_readings_carry_both_joints_and_the_time_of_measurement(driving):
    driving.readings.clear()
    driving.step(10)
    for reading in driving.readings[1:]:
        names = [joint.name for joint in reading.joints]
        assert names == ["steering_motor_joint", "rear_wheel_joint"]
    last = driving.readings[-1]
    assert last.stamp == pytest.approx(driving.now, abs=1e-6)
    assert last.joints[0].position == pytest.approx(0.2, abs=1e-4)
    assert last.joints[1].velocity == pytest.approx(1.0 / 0.335, rel=1e-3)


def test_a_lost_partner_does_not_silence_a_boards_readings(driving):
    driving.readings.clear()
    driving.cut.add(DRIVE)
    driving.step(31)
    assert not driving.bridge.links[DRIVE].up
    assert len(driving.readings) >= 30  # what waited for the partner is not lost
    driving.readings.clear()
    driving.step(20)
    assert len(driving.readings) == 20
    assert {tuple(j.name for j in r.joints) for r in driving.readings} == {
        ("steering_motor_joint",)
    }


def test_a_clock_that_jumps_back_shakes_hands_anew(driving):
    driving.bridge.restart_links(1.0, "the clock jumped back")
    assert not driving.bridge.armed
    driving.now = 1000.0 + 2.0
    driving.bridge.poll(driving.now)
    driving.step(5)
    assert all(link.up for link in driving.bridge.links.values())
