"""Both PLCs against the state machine of the specification (section 5).

Every test runs on two backends: the emulation in Python and the firmware's own C logic.
"""

import dataclasses

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tricycle_bridge.protocol import messages as m
from tricycle_bridge.protocol.framing import FrameDecoder, encode
from tricycle_sim.plc import DriveMeasurement, DrivePlc, SteerMeasurement, SteerPlc
from tricycle_sim.plc.firmware import FirmwareDrivePlc, FirmwareSteerPlc

ENABLE, ESTOP = m.CommandFlag.ENABLE, m.CommandFlag.ESTOP
STEER, DRIVE = m.Board.STEER, m.Board.DRIVE
State, Fault, Op, Result = m.PlcState, m.Fault, m.Op, m.Result


class Bench:
    """A PLC with a host that does exactly what the test says."""

    def __init__(self, plc, *, start_us=0):
        self.plc = plc
        self.board = plc.board
        self.now = start_us  # us
        self.decoder = FrameDecoder(plc.board, host=True)
        self.seq = 0
        self.received = []
        self.state = None
        self.output = None
        is_steer = plc.board is m.Board.STEER
        self.measurement = SteerMeasurement() if is_steer else DriveMeasurement()

    def send(self, message, *, board=None, session=None, seq=None):
        """Returns the PLC's answers."""
        used = self.seq if seq is None else seq
        session = self.decoder.session if session is None else session
        wire = encode(message, board=board or self.board, seq=used, session=session)
        self.seq = (used + 1) & 0xFF
        return self._take(self.plc.receive(wire, self.now))

    def _take(self, data):
        messages = [frame.message for frame in self.decoder.feed(data)]
        self.received += messages
        for message in messages:
            if isinstance(message, m.SteerState | m.DriveState):
                self.state = message
        return messages

    def tick(self, n=1, **measured):
        """n ticks of 10 ms."""
        self.measurement = dataclasses.replace(self.measurement, **measured)
        for _ in range(n):
            data, self.output = self.plc.tick(self.now, self.measurement)
            self._take(data)
            self.now += 10_000
        return self.state

    def hello(self, session=7):
        self.decoder.session = session
        wanted = m.Hello(0, self.board, 99)
        (ack,) = self.send(wanted, session=session)
        return ack

    def command(self, value=0.0, *, flags=ENABLE, limit=0.0, gear=1, brake=0.0, echo=None):
        """value: rad or m/s."""
        echo = m.echo_of(self.now) if echo is None else echo
        if self.board is m.Board.STEER:
            return self.send(m.SteerCommand(flags, 0, round(value * 1e4), round(limit * 1e3), echo))
        return self.send(
            m.DriveCommand(
                flags, gear, round(value * 1e3), round(limit * 1e3), round(brake * 200), 0, echo
            )
        )

    def drive(self, n, value=0.0, **kwargs):
        """n ticks with a command each; the plant is perfect."""
        for _ in range(n):
            self.command(value, **kwargs)
            self.tick()
            if self.board is m.Board.STEER:
                self.measurement = SteerMeasurement(self.output.setpoint)
            else:
                self.measurement = DriveMeasurement(self.output.setpoint)

    def control(self, op, **kwargs):
        answers = self.send(m.Control.of(op), **kwargs)
        (ack,) = [a for a in answers if isinstance(a, m.Ack)]
        return Result(ack.result)

    def stats(self):
        (stats,) = self.send(m.StatsRequest())
        return stats


@pytest.fixture(params=["emulated", "firmware"])
def make_plc(request):
    """Makes the PLC of a board on one of the backends."""
    if request.param == "emulated":
        return lambda board, **kwargs: {STEER: SteerPlc, DRIVE: DrivePlc}[board](**kwargs)
    build = request.getfixturevalue("firmware_libraries")
    classes = {STEER: FirmwareSteerPlc, DRIVE: FirmwareDrivePlc}
    return lambda board, **kwargs: classes[board](build / f"lib{board.name.lower()}.so", **kwargs)


@pytest.fixture(params=[STEER, DRIVE], ids=["steer", "drive"])
def bench(request, make_plc):
    bench = Bench(make_plc(request.param))
    bench.tick()
    bench.hello()
    return bench


@pytest.fixture
def armed(bench):
    bench.drive(5)
    assert bench.control(Op.ARM) is Result.OK
    bench.drive(1)
    assert bench.state.state == State.ARMED
    return bench


@pytest.fixture
def steer(make_plc):
    return _armed_bench(make_plc(STEER))


@pytest.fixture
def drive(make_plc):
    return _armed_bench(make_plc(DRIVE))


def _armed_bench(plc, **kwargs):
    bench = Bench(plc, **kwargs)
    bench.tick()
    bench.hello()
    bench.drive(5)
    assert bench.control(Op.ARM) is Result.OK
    return bench


# ---- handshake ----


def test_boot_is_announced_without_a_session_then_telemetry_flows(make_plc):
    bench = Bench(make_plc(STEER, boot_count=41))
    bench.tick(3)
    boot, *states = bench.received
    assert boot == m.Event(0, m.EventCode.BOOT, State.SAFE, 0)
    assert [s.t for s in states] == [0, 10_000, 20_000]
    ack = bench.hello()
    assert (ack.board, ack.nonce, ack.boot_count, ack.watchdog) == (1, 99, 42, 200)


def test_hello_to_any_board_is_answered_and_to_another_is_not(bench):
    other = 3 - bench.board
    assert len(bench.send(m.Hello(0, 15, 1), board=m.Board.ANY)) == 1
    assert bench.send(m.Hello(0, other, 1), board=m.Board.ANY) == []
    assert bench.send(m.Hello(0, other, 1), board=m.Board(other)) == []


def test_hello_disarms(armed):
    armed.hello(session=9)
    assert armed.tick().state == State.SAFE


def test_a_reset_forgets_the_session(armed):
    armed.plc.reset(m.ResetCause.WATCHDOG)
    assert armed.command() == []
    state = armed.tick()
    assert (state.state, state.faults) == (State.SAFE, Fault.WDT_RESET)
    armed.command()
    assert armed.plc.session == 0
    armed.hello(session=11)
    armed.drive(5)
    assert armed.control(Op.ARM) is Result.WRONG_STATE  # the fault needs CLEAR
    assert armed.control(Op.CLEAR) is Result.OK
    assert armed.control(Op.ARM) is Result.OK


# ---- arming ----


def test_arming_needs_five_fresh_enabled_commands_in_a_row(bench):
    bench.drive(4)
    assert bench.control(Op.ARM) is Result.PRECONDITIONS
    bench.drive(1, flags=0)
    bench.drive(4)
    assert bench.control(Op.ARM) is Result.PRECONDITIONS
    bench.command(echo=m.echo_of(bench.now - 200_000))  # stale: the row begins anew
    bench.drive(4)
    assert bench.control(Op.ARM) is Result.PRECONDITIONS
    bench.drive(1)
    bench.tick(21)  # the newest is older than 200 ms
    assert bench.control(Op.ARM) is Result.PRECONDITIONS
    bench.drive(4)  # the row began anew
    assert bench.control(Op.ARM) is Result.PRECONDITIONS
    bench.drive(1)
    assert bench.control(Op.ARM) is Result.OK
    assert bench.control(Op.ARM) is Result.OK  # already satisfied


@pytest.mark.parametrize(("age", "result"), [(200_000, Result.OK), (200_001, Result.PRECONDITIONS)])
def test_the_newest_command_may_be_200_ms_old_for_arming(bench, age, result):
    bench.drive(5)  # the last command came a tick ago
    bench.now += age - 10_000
    assert bench.control(Op.ARM) is result


def test_the_drive_arms_only_at_commanded_speed_zero(make_plc):
    bench = Bench(make_plc(DRIVE))
    bench.tick()
    bench.hello()
    bench.drive(5, 0.5)
    assert bench.control(Op.ARM) is Result.PRECONDITIONS


def test_the_steering_starts_at_the_measured_angle(make_plc):
    bench = Bench(make_plc(STEER))
    bench.tick(angle=0.3)
    bench.hello()
    for _ in range(5):
        bench.command(0.0, limit=1.0)
        bench.tick()
    bench.control(Op.ARM)
    bench.tick()
    assert bench.output.servo_on
    assert bench.output.setpoint == pytest.approx(0.3 - 0.01)


@pytest.mark.parametrize("op", [Op.DISARM, Op.ESTOP, Op.CLEAR])
def test_satisfied_operations_are_answered_with_ok(bench, op):
    assert bench.control(op) is Result.OK
    assert bench.control(op) is Result.OK


def test_ctrl_is_refused_for_bad_guards_and_unknown_ops(bench):
    (ack,) = bench.send(m.Control(1, 0, 0xFE, 0))
    assert ack.result == Result.BAD_GUARD
    (ack,) = bench.send(m.Control.of(9))
    assert ack.result == Result.UNKNOWN_OP


def test_ctrl_of_another_session_is_not_answered(armed):
    assert armed.send(m.Control.of(Op.DISARM), session=8) == []
    assert armed.stats().session == 1


# ---- leaving ARMED ----


@pytest.mark.parametrize("phase", range(0, 10_000, 1_111))
def test_the_watchdog_trips_after_200_to_210_ms(armed, phase):
    armed.now += phase
    armed.command()
    since = armed.now
    armed.now += 10_000 - phase
    while armed.plc.state is State.ARMED:
        armed.tick()
    trip = State.ARMED << 4 | State.STOPPING
    (event,) = [e for e in armed.received if isinstance(e, m.Event) and e.states == trip]
    assert 200_000 <= event.t - since < 210_000
    assert event.faults == Fault.CMD_TIMEOUT
    assert armed.stats().watchdog_trips == 1


def test_a_timed_out_board_never_arms_again_by_itself(armed):
    armed.tick(25)
    armed.drive(150)
    assert armed.state.state == State.SAFE
    assert armed.state.faults == Fault.CMD_TIMEOUT
    assert armed.control(Op.ARM) is Result.WRONG_STATE
    assert armed.control(Op.CLEAR) is Result.OK
    assert armed.control(Op.ARM) is Result.OK


def test_stale_commands_do_not_feed_the_watchdog(armed):
    old = m.echo_of(armed.now)
    for _ in range(60):
        armed.command(echo=old)
        armed.tick()
    assert armed.plc.state is not State.ARMED
    assert armed.stats().stale > 30


def test_an_echo_is_fresh_up_to_150_units(armed):
    echo = (m.echo_of(armed.now) - 150) & 0xFFFF
    armed.command(echo=echo)
    assert armed.stats().stale == 0
    armed.command(echo=(echo - 1) & 0xFFFF)
    assert armed.stats().stale == 1
    armed.command(echo=(m.echo_of(armed.now) + 1) & 0xFFFF)  # from the future
    assert armed.stats().stale == 2


def test_enable_zero_stops_the_steering_for_a_second_without_a_fault(steer):
    steer.drive(10, 0.2)
    held = steer.output.setpoint
    for _ in range(100):
        steer.command(0.0, flags=0)
        steer.tick()
        assert steer.plc.state is State.STOPPING
        assert steer.output.setpoint == held
        assert steer.output.servo_on
    steer.tick(2)
    assert (steer.state.state, steer.state.faults, steer.output.servo_on) == (State.SAFE, 0, False)


def test_stopping_ramps_the_drive_to_rest_then_brakes(drive):
    drive.drive(300, 2.0)
    assert drive.output.setpoint == 2.0
    speeds = []
    while drive.plc.state in (State.ARMED, State.STOPPING):
        drive.drive(1, 2.0, flags=0)
        speeds.append(drive.output.setpoint)
    assert speeds[0] == pytest.approx(2.0 - 0.02)
    assert len(speeds) == pytest.approx(100, abs=2)
    assert (drive.output.motor_on, drive.output.brake) == (False, 1.0)
    assert drive.state.faults == 0


@pytest.mark.parametrize("how", ["op", "flag", "pin"])
def test_every_emergency_stop_latches_and_cuts_the_outputs(armed, how):
    if how == "op":
        assert armed.control(Op.ESTOP) is Result.OK
    elif how == "flag":
        armed.command(flags=ENABLE | ESTOP)
    armed.tick(estop_pressed=how == "pin")
    fault = Fault.ESTOP_HW if how == "pin" else Fault.ESTOP_HOST
    assert (armed.state.state, armed.state.faults) == (State.ESTOP, fault)
    if armed.board is m.Board.STEER:
        assert not armed.output.servo_on
    else:
        assert (armed.output.motor_on, armed.output.brake) == (False, 1.0)
    armed.drive(5)
    if how == "pin":
        armed.tick(estop_pressed=True)
        assert armed.control(Op.CLEAR) is Result.PRECONDITIONS
    armed.tick(estop_pressed=False)
    assert armed.control(Op.ARM) is Result.WRONG_STATE
    assert armed.control(Op.CLEAR) is Result.OK
    assert armed.tick().state == State.SAFE


def test_a_broken_potentiometer_is_a_latched_fault(steer):
    steer.command()
    steer.tick(adc=4)
    assert (steer.state.state, steer.state.faults) == (State.FAULT, Fault.SENSOR)
    steer.drive(5)
    assert steer.state.state == State.FAULT


def test_a_blocked_steering_is_a_tracking_fault_after_a_second(steer):
    ticks = 0
    while steer.plc.state is State.ARMED:
        steer.command(0.5)
        steer.tick(angle=0.0)
        ticks += 1
    assert steer.state.faults == Fault.TRACKING
    assert ticks == pytest.approx(100 + 5, abs=2)  # 0.15 rad at 3 rad/s take 5 ticks


def test_a_blocked_wheel_is_a_stall_and_a_fast_one_an_overspeed(drive, make_plc):
    while drive.plc.state is State.ARMED:
        drive.command(1.0)
        drive.tick(speed=0.0)
    assert drive.state.faults == Fault.STALL
    fast = _armed_bench(make_plc(DRIVE))
    fast.command(1.0)
    fast.tick(speed=5.5)
    assert (fast.state.state, fast.state.faults) == (State.FAULT, Fault.OVERSPEED)


# ---- limits ----


def test_commands_outside_the_limits_are_limited_and_reported_while_it_lasts(steer):
    steer.drive(100, 3.0, limit=60.0)
    assert steer.output.setpoint == pytest.approx(0.7854)
    assert steer.state.faults == Fault.LIMIT
    assert steer.state.flags & m.StateFlag.LIMITED
    steer.drive(1, 0.5)
    assert steer.state.faults == 0
    for angle, rate, flag in ((3.0, 1.0, True), (0.5, 60.0, True), (0.5, 1.0, False)):
        steer.drive(1, angle, limit=rate)
        assert bool(steer.state.flags & m.StateFlag.LIMITED) is flag


def test_drive_commands_are_limited_never_wrapped(drive):
    drive.drive(300, 32.767, limit=65.0)
    assert drive.output.setpoint == pytest.approx(4.8)
    drive.command(0.0)
    drive.send(m.DriveCommand(ENABLE, 1, -30000, 0, 255, 0, m.echo_of(drive.now)))
    drive.tick()
    assert drive.output.brake == 1.0
    drive.drive(300, 0.0)
    assert drive.output.setpoint == 0.0
    for speed, limit, flag in ((32.0, 1.0, True), (0.5, 65.0, True), (0.5, 1.0, False)):
        drive.drive(1, speed, limit=limit)
        assert bool(drive.state.flags & m.StateFlag.LIMITED) is flag


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(st.tuples(st.integers(-32768, 32767), st.integers(0, 65535)), min_size=1, max_size=30)
)
def test_the_steering_setpoint_is_never_faster_nor_further_than_its_limits(make_plc, commands):
    bench = _armed_bench(make_plc(STEER))
    last = bench.tick().setpoint * 1e-4
    for angle, rate in commands:
        bench.send(m.SteerCommand(ENABLE, 0, angle, rate, m.echo_of(bench.now)))
        bench.tick()
        allowed = min(rate * 1e-3 or 3.0, 3.0) * 0.01
        assert abs(bench.output.setpoint - last) <= allowed + 1e-12
        assert abs(bench.output.setpoint) <= 0.7854
        last = bench.output.setpoint
        bench.measurement = SteerMeasurement(last)


def test_the_gear_changes_only_at_rest(drive):
    drive.drive(100, 1.0, limit=1.0, gear=1)
    assert drive.output.setpoint == pytest.approx(1.0)
    seen = []
    for _ in range(300):
        drive.drive(1, 0.5, limit=1.0, gear=2)
        seen.append((drive.state.gear, drive.output.setpoint))
    assert all(setpoint >= 0 for gear, setpoint in seen if gear == 1)
    assert all(setpoint <= 0 for gear, setpoint in seen if gear == 2)
    assert seen[-1] == (2, -0.5)


# ---- sequence, counters, clock ----


def test_duplicates_are_ignored_and_gaps_counted(armed):
    seq = armed.seq
    assert len(armed.send(m.Ping(1), seq=seq)) == 1
    assert armed.send(m.Ping(1), seq=seq) == []
    assert len(armed.send(m.Ping(1), seq=(seq + 4) & 0xFF)) == 1
    stats = armed.stats()
    assert (stats.duplicate, stats.seq_gap) == (1, 3)


def test_the_watchdog_and_the_echo_hold_across_the_wrap_of_the_clock(make_plc):
    bench = _armed_bench(make_plc(STEER), start_us=(1 << 32) - 500_000)
    bench.drive(100, 0.1)
    assert bench.state.t < 1_000_000
    assert bench.state.state == State.ARMED
    assert bench.stats().stale == 0


def test_limits_tell_what_the_plc_enforces(make_plc):
    (limits,) = _armed_bench(make_plc(STEER)).send(m.LimitsRequest())
    assert (limits.max_angle, limits.max_rate, limits.watchdog, limits.stale) == (
        7854,
        3000,
        200,
        150,
    )
    (limits,) = _armed_bench(make_plc(DRIVE)).send(m.LimitsRequest())
    assert (limits.max_speed, limits.max_acceleration) == (4800, 2000)
