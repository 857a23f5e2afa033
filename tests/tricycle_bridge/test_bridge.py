"""The bridge's rules against both emulated PLCs, on a simulated clock."""

import math
import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tricycle_bridge.bridge import Bridge, BridgeSettings, Setpoint, Source
from tricycle_bridge.diagnosis import diagnose
from tricycle_bridge.protocol.messages import Board, Fault, PlcState
from tricycle_core.diagnostics import Level
from tricycle_core.errors import LinkError
from tricycle_sim.plc import DriveMeasurement, DrivePlc, SteerMeasurement, SteerPlc

STEER, DRIVE = Board.STEER, Board.DRIVE


class Vehicle:
    """Both boards on perfect cables, a perfect plant, a commander; 10 ms per step."""

    def __init__(self, **settings):
        self.bridge = Bridge(BridgeSettings(**settings), rng=random.Random(0))
        self.bridge.active = True
        self.plcs = {STEER: SteerPlc(), DRIVE: DrivePlc()}
        self.measured = {STEER: SteerMeasurement(), DRIVE: DriveMeasurement()}
        self.cut = set()  # boards whose cable is cut
        self.now = 1000.0
        self.target = (0.0, 0.0)  # rad, m/s; None: no commander
        self.outcomes = []
        self.readings = []
        self.warnings = []
        self.commands = {STEER: 0, DRIVE: 0}
        for board, plc in self.plcs.items():
            plc.tick(0, self.measured[board])
            self.bridge.opened(board, self.now)
        self.step(5)

    def step(self, ticks=1):
        for _ in range(ticks):
            self.now += 0.01
            now_us = round((self.now - 1000.0) * 1e6)
            answers = {}
            if self.target is not None:
                self.bridge.set_command(
                    Setpoint(*self.target),
                    stamp=self.now,
                    now=self.now,
                    source=Source.JOINT_COMMANDS,
                )
            self.bridge.poll(self.now)
            for board, frames in self.bridge.take_frames().items():
                self.commands[board] += sum(len(f) > 17 for f in frames)  # set-points are long
                data = b"" if board in self.cut else b"".join(frames)
                answers[board] = self.plcs[board].receive(data, now_us)
            for board, plc in self.plcs.items():
                data, output = plc.tick(now_us, self.measured[board])
                self._move(board, output)
                if board not in self.cut:
                    self.bridge.receive(board, answers[board] + data, self.now)
            self.readings += self.bridge.take_readings()
            self.warnings += [text for bad, text in self.bridge.take_messages() if bad]

    def _move(self, board, output):
        if board is STEER:
            if output.servo_on:
                self.measured[STEER] = SteerMeasurement(output.setpoint)
        else:
            speed = output.setpoint if output.motor_on else 0.0
            self.measured[DRIVE] = DriveMeasurement(speed)

    def arm(self):
        self.bridge.arm(self.now, lambda *outcome: self.outcomes.append(outcome))
        self.step(30)
        return self.outcomes[-1]

    def state(self, board):
        return self.plcs[board].state


@pytest.fixture
def vehicle():
    return Vehicle()


@pytest.fixture
def driving():
    vehicle = Vehicle()
    assert vehicle.arm() == (True, "armed")
    vehicle.target = (0.2, 1.0)
    vehicle.step(150)
    assert vehicle.measured[DRIVE].speed == pytest.approx(1.0)
    assert vehicle.measured[STEER].angle == pytest.approx(0.2)
    return vehicle


def test_nothing_arms_without_the_operator(vehicle):
    vehicle.step(500)
    assert not vehicle.bridge.armed
    assert {p.state for p in vehicle.plcs.values()} == {PlcState.SAFE}


def test_arming_and_driving(driving):
    assert driving.bridge.armed
    assert driving.arm() == (True, "already armed")


def test_arming_at_once_after_a_stop_says_what_to_wait_for(vehicle):
    vehicle.arm()
    vehicle.bridge.stop("the operator's wish")
    assert vehicle.arm() == (False, "not armed: steer PLC: still stopping")
    vehicle.step(100)
    assert vehicle.arm() == (True, "armed")


def _without_commander(v):
    v.target = None
    v.step(20)


def _moving_command(v):
    v.target = (0.0, 0.5)
    v.step()


def _cut_steer(v):
    v.cut.add(STEER)
    v.step(40)


def _inactive(v):
    v.bridge.active = False


def _pressed(v):
    v.measured[DRIVE] = DriveMeasurement(estop_pressed=True)
    v.plcs[DRIVE].tick(round((v.now - 1000) * 1e6), v.measured[DRIVE])
    data, _ = v.plcs[DRIVE].tick(round((v.now - 1000) * 1e6), v.measured[DRIVE])
    v.bridge.receive(DRIVE, data, v.now)


@pytest.mark.parametrize(
    ("cause", "reason"),
    [
        (_without_commander, "no command stream"),
        (_moving_command, "commanded speed is 0.50 m/s, must be 0"),
        (_cut_steer, "steer PLC: no telemetry for"),
        (_inactive, "the bridge is not active"),
        (_pressed, "drive PLC: hardware e-stop pressed"),
    ],
)
def test_every_refusal_says_why(vehicle, cause, reason):
    cause(vehicle)
    success, text = vehicle.arm()
    assert not success
    assert text.startswith(f"not armed: {reason}")
    assert not vehicle.bridge.armed


def test_when_one_board_does_not_arm_neither_stays_armed(vehicle):
    vehicle.measured[STEER] = SteerMeasurement(adc=2)
    success, text = vehicle.arm()
    assert not success
    assert text == "not armed: steer PLC is FAULT (SENSOR)"
    vehicle.step(150)
    assert {p.state for p in vehicle.plcs.values()} <= {PlcState.SAFE, PlcState.FAULT}


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
            Setpoint(k * 1e-4, 0.0), stamp=now, now=now, source=Source.JOINT_COMMANDS
        )
        frames += len(vehicle.bridge.take_frames()[STEER])
    assert 90 <= frames <= 112


def test_the_jitter_of_a_100_hz_commander_adds_up_to_no_lag(vehicle):
    rng = random.Random(5)
    held_up = 0
    arrivals = sorted(k * 0.01 + rng.choice((0.0, 0.0, 0.0, 0.012)) for k in range(2000))
    for k, arrival in enumerate(arrivals):
        now = vehicle.now + 0.01 + arrival
        vehicle.bridge.set_command(
            Setpoint(k * 1e-4, 0.0), stamp=now, now=now, source=Source.JOINT_COMMANDS
        )
        held_up += not vehicle.bridge.take_frames()[STEER]
        vehicle.bridge.links[STEER]._telemetry_at = now  # the board is fine
    assert held_up < 0.02 * len(arrivals)


@pytest.mark.parametrize("age", [0.15, -0.15, 1e9])
def test_old_and_future_commands_are_refused(vehicle, age):
    refusal = vehicle.bridge.set_command(
        Setpoint(0.5, 1.0), stamp=vehicle.now - age, now=vehicle.now, source=Source.JOINT_COMMANDS
    )
    assert "must be within 0.1 s" in refusal
    assert vehicle.bridge.counters.stale == 1


def test_a_command_without_a_stamp_is_refused(vehicle):
    refusal = vehicle.bridge.set_command(
        Setpoint(0.5, 1.0), stamp=0.0, now=vehicle.now, source=Source.CMD_VEL
    )
    assert refusal == "cmd_vel has no time stamp"


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_numbers_that_are_none_are_refused(value):
    with pytest.raises(LinkError, match=r"steering_motor_angle is .* must be a finite number"):
        Setpoint(value, 0.0)
    with pytest.raises(LinkError, match="speed is"):
        Setpoint(0.0, value)


def test_joint_commands_win_over_cmd_vel(driving):
    refusal = driving.bridge.set_command(
        Setpoint(0.0, 0.0), stamp=driving.now, now=driving.now, source=Source.CMD_VEL
    )
    assert refusal == "cmd_vel ignored while joint_commands are coming"
    driving.step()
    assert driving.measured[DRIVE].speed == pytest.approx(1.0)


@settings(max_examples=50)
@given(st.floats(-1e300, 1e300), st.floats(-1e300, 1e300))
def test_no_finite_command_breaks_or_exceeds_anything(angle, speed):
    vehicle = Vehicle()
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


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("command_rate", 10.0),
        ("tyre_radius", 0.0),
        ("max_steering_rate", 3.5),
        ("max_acceleration", math.nan),
    ],
)
def test_settings_out_of_range_are_named(name, value):
    with pytest.raises(LinkError, match=f"{name} = "):
        BridgeSettings(**{name: value})


# ---- what it tells ----


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


@pytest.mark.parametrize("burst", [2, 20])
def test_boards_that_speak_in_bursts_are_still_paired(driving, burst):
    """One port is read as a whole before the other one."""
    held = {STEER: b"", DRIVE: b""}
    receive = driving.bridge.receive
    driving.bridge.receive = lambda board, data, now: held.__setitem__(board, held[board] + data)
    driving.readings.clear()
    for _ in range(8):
        driving.step(burst)
        for board in (STEER, DRIVE):
            receive(board, held.pop(board), driving.now)
            held[board] = b""
    driving.step()
    assert len(driving.readings) == 8 * burst
    assert {len(reading.joints) for reading in driving.readings} == {2}
    stamps = [reading.stamp for reading in driving.readings]
    assert stamps == sorted(stamps)


def test_diagnostics_name_states_and_faults(driving):
    vehicle, steer, drive = diagnose(driving.bridge, driving.now)
    assert (vehicle.level, vehicle.message) == (Level.OK, "armed")
    assert (steer.level, steer.message) == (Level.OK, "ARMED")
    assert steer.values["firmware_steer"].count(".") == 2  # copied to a bag's metadata
    driving.target = None
    driving.step(150)
    vehicle, steer, drive = diagnose(driving.bridge, driving.now)
    assert (vehicle.level, vehicle.message) == (Level.WARN, "not armed: no command stream")
    assert (drive.level, drive.message) == (Level.WARN, "SAFE (CMD_TIMEOUT)")
    assert drive.values["PLC: watchdog trips"] == "1"
    driving.bridge.closed(STEER, "/dev/x does not exist")
    _, steer, _ = diagnose(driving.bridge, driving.now)
    assert (steer.level, steer.message) == (Level.ERROR, "/dev/x does not exist")


def test_a_clock_that_jumps_back_shakes_hands_anew(driving):
    driving.bridge.restart_links(1.0, "the clock jumped back")
    assert not driving.bridge.armed
    driving.now = 1000.0 + 2.0
    driving.bridge.poll(driving.now)
    driving.step(5)
    assert all(link.up for link in driving.bridge.links.values())
