"""The bridge's rules against both emulated PLCs, on a simulated clock."""

import dataclasses

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tricycle_bridge.bridge import Bridge
from tricycle_bridge.commands.command_stream import Source, VehicleCommand
from tricycle_bridge.diagnosis import diagnose
from tricycle_bridge.protocol.boards import LINE_OPEN
from tricycle_bridge.protocol.messages import Board, CommandFlag, Fault, PlcState
from tricycle_core.diagnostics import Level
from tricycle_core.readiness import Readiness
from tricycle_core.timing import TICK
from tricycle_sim.plc import SteerMeasurement

STEER, DRIVE = Board.STEER, Board.DRIVE


def test_nothing_arms_without_the_operator(vehicle):
    vehicle.step(500)
    assert not vehicle.bridge.armed
    assert {p.state for p in vehicle.plcs.values()} == {PlcState.SAFE}


def test_arming_asks_for_the_bring_up(vehicle):
    vehicle.bridge.bring_up_problem = lambda: "the bring-up did not pass: brake"
    assert vehicle.arm() == (False, "not armed: the bring-up did not pass: brake")
    vehicle.bridge.bring_up_problem = lambda: None
    assert vehicle.arm() == (True, "armed")


def test_arming_and_driving(driving):
    assert driving.bridge.armed
    assert driving.arm() == (True, "already armed")


def test_a_commander_that_stops_is_not_replaced(driving):
    driving.target = None
    driving.step(12)
    sent = dict(driving.commands)
    driving.step(10)
    assert driving.commands == sent  # no set-point is repeated to keep a board alive
    driving.until_stopped()
    assert driving.state(DRIVE) is PlcState.SAFE
    assert driving.plcs[DRIVE].faults & Fault.CMD_TIMEOUT
    assert driving.measured[DRIVE].speed == 0.0
    driving.target = (0.2, 1.0)
    driving.step(300)
    assert driving.state(DRIVE) is PlcState.SAFE  # only the operator arms


def test_a_poll_is_due_a_tick_after_the_last_one_and_when_the_clock_went_back(driving):
    bridge, now = driving.bridge, driving.now
    bridge.poll(now)
    assert not bridge.poll_is_due(now)
    assert not bridge.poll_is_due(now + 0.005)
    assert bridge.poll_is_due(now + TICK)
    assert bridge.poll_is_due(now - 1.0)


# ---- standstill without a commander ----


def test_an_armed_vehicle_stands_still_until_somebody_commands(vehicle):
    vehicle.target = None
    vehicle.measured[STEER] = SteerMeasurement(0.3)
    vehicle.step(20)
    assert vehicle.arm() == (True, "armed")
    vehicle.step(300)
    assert vehicle.bridge.armed
    assert vehicle.measured[STEER].angle == pytest.approx(0.3, abs=1e-4)  # where it was
    vehicle.target = (0.1, 0.5)
    vehicle.step(100)
    assert vehicle.measured[DRIVE].speed == pytest.approx(0.5)


def test_a_command_of_before_arming_does_not_turn_the_steering(vehicle):
    vehicle.target = (0.3, 0.0)  # of the drive before, after which the vehicle was set back
    vehicle.step()
    vehicle.target = None
    assert vehicle.arm() == (True, "armed")
    vehicle.step(100)
    assert vehicle.measured[STEER].angle == 0.0


def test_a_commander_that_stops_the_vehicle_and_falls_silent_leaves_it_at_rest(driving):
    driving.target = (0.2, 0.0)
    driving.step(120)
    driving.target = None
    driving.step(500)
    assert driving.bridge.armed
    assert driving.measured[STEER].angle == pytest.approx(0.2)
    assert driving.measured[DRIVE].speed == 0.0
    assert driving.bridge.commands.commander.name == "/driver"  # still its vehicle


def test_a_commander_that_falls_silent_while_it_stops_the_vehicle_is_not_replaced(driving):
    driving.target = (0.2, 0.0)
    driving.step(20)
    driving.target = None
    driving.until_stopped()
    assert driving.plcs[DRIVE].faults & Fault.CMD_TIMEOUT


def test_the_steering_is_told_that_the_vehicle_stands_still(driving):
    flags = []
    steer = driving.bridge.links[STEER]
    send = steer.send_command
    steer.send_command = lambda command: flags.append(command.flags) or send(command)
    driving.step(10)
    assert not any(f & CommandFlag.STANDSTILL for f in flags)
    driving.bridge.stop("the operator's wish")
    driving.until_stopped()
    flags.clear()
    driving.step(10)
    assert set(flags) == {CommandFlag.STANDSTILL}
    driving.step(30)
    assert not driving.servo_on


def test_the_steering_lets_go_only_after_a_while_at_rest(driving):
    driving.bridge.stop("the operator's wish")
    resting = 0  # ticks
    while driving.servo_on:
        driving.step()
        resting += driving.measured[DRIVE].speed == 0.0
        assert resting < 60
    assert resting >= 25


@pytest.mark.parametrize("fault", [Fault.OVERSPEED, Fault.STOP_TIMEOUT])
def test_a_faulty_wheel_does_not_let_the_steering_go(driving, fault):
    plc = driving.plcs[DRIVE]
    plc.state = PlcState.FAULT
    plc.faults |= fault
    driving.step(500)
    assert driving.measured[DRIVE].speed == 0.0
    assert driving.servo_on


def test_while_the_steering_holds_nothing_is_armed(driving):
    driving.bridge.emergency_stop(driving.now)
    driving.target = (0.2, 0.0)
    driving.step(2)
    assert driving.servo_on
    accepted, reason = driving.arm()
    assert not accepted
    assert "still holds its angle" in reason


@pytest.mark.parametrize("sensor", ["broken", "contradicted by odometry"])
def test_a_wheel_that_is_not_trusted_does_not_let_the_steering_go(driving, sensor):
    driving.measured[DRIVE] = stuck = dataclasses.replace(driving.measured[DRIVE], speed=0.0)
    if sensor == "broken":
        stuck = dataclasses.replace(stuck, hall_line=LINE_OPEN)
    for _ in range(500):
        driving.bridge.set_odometry(1.0, driving.now)
        driving.measured[DRIVE] = stuck
        driving.step()
    assert driving.state(DRIVE) is not PlcState.ARMED
    assert driving.servo_on


def test_without_the_drives_telemetry_nobody_says_that_the_vehicle_stands_still(driving):
    driving.cut.add(DRIVE)
    driving.step(900)
    assert driving.state(DRIVE) is PlcState.SAFE
    assert driving.state(STEER) is PlcState.STOPPING  # it holds for ten seconds
    driving.until_stopped()


# ---- one commander ----


def other_commands(vehicle, *target):
    return vehicle.bridge.set_command(
        VehicleCommand(*target), stamp=vehicle.now, now=vehicle.now, source=Source.CMD_VEL
    )


def test_a_second_commander_is_refused_by_name_and_reported(driving):
    refusal = "cmd_vel is refused: joint_commands of /driver commands the vehicle"
    assert other_commands(driving, 0.0, 0.0) == refusal
    driving.step()
    assert driving.measured[DRIVE].speed == pytest.approx(1.0)
    vehicle, *_ = diagnose(driving.bridge, driving.now)
    assert (vehicle.level, vehicle.message) == (Level.ERROR, f"armed; {refusal}")
    assert driving.bridge.readiness(driving.now) == Readiness(True, commander="/driver")
    driving.step(150)
    assert diagnose(driving.bridge, driving.now)[0].level is Level.OK


def test_a_commander_has_the_boards_stop_the_vehicle_until_it_is_armed(driving):
    def stop(name):
        now = driving.now
        return driving.bridge.set_command(
            None, stamp=now, now=now, source=Source.JOINT_COMMANDS, name=name
        )

    assert stop("/other").startswith("joint_commands of /other is refused")
    driving.step()
    assert driving.bridge.armed
    assert stop("/driver") is None
    driving.step(3)  # although the driver commands on
    assert driving.bridge.links[DRIVE].telemetry.state == PlcState.STOPPING
    assert "stopped: by joint_commands of /driver" in driving.bridge.readiness(driving.now).reason
    driving.step(250)
    assert driving.measured[DRIVE].speed == 0.0
    driving.target = None
    driving.step(20)
    assert driving.arm() == (True, "armed")


def test_a_vehicle_is_handed_over_at_rest_only(driving):
    text = "not released: the vehicle moves at 1.00 m/s for joint_commands of /driver"
    assert driving.bridge.release(driving.now) == (False, text)
    driving.target = (0.2, 0.0)
    driving.step(120)
    assert driving.bridge.release(driving.now) == (True, "released by joint_commands of /driver")
    driving.target = None
    driving.step(100)
    assert driving.bridge.armed
    assert other_commands(driving, 0.2, 0.5) is None
    assert driving.bridge.readiness(driving.now).commander == "cmd_vel"


def test_disarming_hands_the_vehicle_over_too(driving):
    driving.bridge.disarm(driving.now)
    driving.target = None
    driving.step(200)
    assert driving.arm() == (True, "armed")
    assert other_commands(driving, 0.0, 0.5) is None


def test_publishers_that_do_not_say_who_they_are_are_reported(vehicle):
    vehicle.target = None
    other_commands(vehicle, 0.0, 0.0)
    state = diagnose(vehicle.bridge, vehicle.now, {Source.CMD_VEL: ["/a", "/b"]})[0]
    assert state.level is Level.WARN
    assert state.message.endswith("; 2 publishers of cmd_vel that do not say who sends")


# ---- what is refused means standstill ----


@pytest.mark.parametrize(
    ("target", "limit"),
    [
        ((9.0, 1.0), "steering angle 9 rad: at most 0.7461 rad"),
        ((0.2, 1e300), "speed 1e+300 m/s: at most 4.8 m/s"),
    ],
)
def test_a_command_beyond_a_limit_stops_the_vehicle(driving, target, limit):
    driving.target = target
    for _ in range(100):
        driving.step()
    assert driving.measured[DRIVE].speed == 0.0
    assert driving.measured[STEER].angle == pytest.approx(0.2)
    assert driving.bridge.armed
    refusal = driving.bridge.set_command(
        VehicleCommand(*target),
        stamp=driving.now,
        now=driving.now,
        source=Source.JOINT_COMMANDS,
        name="/driver",
    )
    assert refusal == (
        f"joint_commands of /driver is refused: {limit}; the vehicle is to stand still"
    )
    assert driving.bridge.commands.counters.refused > 90
    readiness = Readiness(True, commander="/driver", refused=limit)
    assert driving.bridge.readiness(driving.now) == readiness
    driving.target = (0.2, 0.0)
    driving.step()
    assert driving.bridge.readiness(driving.now) == readiness._replace(refused="")


def test_nonsense_of_a_second_commander_does_not_stop_the_vehicle(driving):
    assert "commands the vehicle" in other_commands(driving, 0.0, 99.0)
    driving.step()
    assert driving.measured[DRIVE].speed == pytest.approx(1.0)


# ---- odometry ----


def test_a_wheel_that_loses_half_of_its_pulses_stops_the_vehicle(driving):
    for _ in range(40):
        driving.bridge.set_odometry(2.04, driving.now)
        driving.step()
    reason = "the wheel says 1.00 m/s, odom 2.04 m/s: hall sensor miscounts?"
    assert driving.bridge.stopped_by == reason
    assert driving.state(DRIVE) is PlcState.STOPPING
    driving.until_stopped()
    assert f"stopped: {reason}" in driving.bridge.readiness(driving.now).reason


def test_diagnostics_say_whether_odometry_is_watched(driving):
    key = "wheel speed against odom"
    assert diagnose(driving.bridge, driving.now)[0].values[key] == "not watched: no odom"
    driving.bridge.set_odometry(1.0, driving.now)
    assert diagnose(driving.bridge, driving.now)[0].values[key] == "watched"


# ---- losses ----


@pytest.mark.parametrize("lost", [STEER, DRIVE])
def test_losing_one_board_stops_the_other_without_a_fault(driving, lost):
    other = DRIVE if lost is STEER else STEER
    driving.cut.add(lost)
    driving.step(40)
    assert driving.state(other) is PlcState.STOPPING
    driving.until_stopped()
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
    assert [p.state for p in driving.plcs.values()] == [PlcState.ESTOP] * 2
    assert driving.arm() == (True, "armed")


def test_an_estop_whose_operation_is_lost_comes_with_the_commands(driving):
    for link in driving.bridge.links.values():
        link.operate = lambda *_: None
    driving.bridge.emergency_stop(driving.now)
    driving.step(100)
    assert [p.state for p in driving.plcs.values()] == [PlcState.ESTOP] * 2


def test_disarm_takes_the_drive_away_at_once(driving):
    driving.bridge.disarm(driving.now)
    driving.step(2)
    assert [p.state for p in driving.plcs.values()] == [PlcState.SAFE] * 2


@pytest.mark.parametrize(
    ("ask", "op"), [(Bridge.disarm, "DISARM"), (Bridge.emergency_stop, "ESTOP")]
)
def test_a_stop_that_does_not_reach_a_board_is_told(driving, ask, op):
    driving.plcs[DRIVE].receive = lambda _data, _now_us: b""
    assert ask(driving.bridge, driving.now) == (True, f"{op} sent")
    driving.step(25)
    assert driving.warnings[-1] == f"drive PLC did not answer {op}"
    driving.bridge.closed(DRIVE, "unplugged")
    driving.step()
    assert ask(driving.bridge, driving.now) == (False, f"{op} sent; no link to the drive PLC")


def test_a_pulled_cable_is_told_once(driving):
    for _ in range(2):
        driving.bridge.closed(STEER, "unplugged")
        driving.step()
    assert driving.warnings == ["steer PLC: unplugged", "stopped: steer PLC: unplugged"]


def test_stop_lets_the_vehicle_roll_out(driving):
    driving.bridge.stop("the bridge was deactivated")
    driving.bridge.active = False
    driving.step(2)
    assert [p.state for p in driving.plcs.values()] == [PlcState.STOPPING] * 2
    driving.step(200)
    assert driving.plcs[DRIVE].faults == 0
    # the steering, too, is told that the vehicle stands, also by a bridge that is not active
    assert [p.state for p in driving.plcs.values()] == [PlcState.SAFE] * 2


# ---- commands ----


def test_every_message_of_a_100_hz_commander_goes_out_at_once(vehicle):
    before = dict(vehicle.commands)
    vehicle.step(100)
    for board in (STEER, DRIVE):
        assert vehicle.commands[board] - before[board] == pytest.approx(100, abs=4)  # + requests


def test_without_a_commander_standstill_goes_out_at_the_command_rate(vehicle):
    vehicle.target = None
    before = dict(vehicle.commands)
    vehicle.step(100)
    for board in (STEER, DRIVE):
        assert vehicle.commands[board] - before[board] == pytest.approx(50, abs=3)


def test_a_commander_at_1_khz_does_not_overload_the_line(vehicle):
    frames = 0
    for k in range(1000):
        now = vehicle.now + k * 0.001
        vehicle.bridge.set_command(
            VehicleCommand(k * 1e-4, 0.0), stamp=now, now=now, source=Source.JOINT_COMMANDS
        )
        frames += len(vehicle.bridge.take_frames()[STEER])
    assert 90 <= frames <= 112


@pytest.mark.slow
@settings(max_examples=50)
@given(
    st.floats(-1e300, 1e300) | st.floats(-0.7, 0.7), st.floats(-1e300, 1e300) | st.floats(-4.8, 4.8)
)
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
