"""One contract for everything that speaks the protocol as a PLC, met over its line alone.

Backends: the emulation in memory, the firmware's C logic in memory, the emulation on a pty in real
time, and the flashed firmware on a simulated ATmega328P. A host sends frames and reads what comes
back; nothing else is looked at but the actuators and the wheel. (test_plc.py and its neighbours
look closer, at the emulation and at the firmware's C logic.)
"""

import os
import select
import time

import pytest
from plc_bench import (
    DRIVE,
    ENABLE,
    ESTOP,
    HALL_SENSORS,
    MASS,
    SETUP,
    STANDSTILL,
    STEER,
    Fault,
    Op,
    Result,
    SpeedController,
    State,
    Wheel,
)

from tricycle_bridge.protocol import messages as m
from tricycle_bridge.protocol.framing import FrameDecoder, encode
from tricycle_sim.plc import DriveMeasurement, DrivePlc, SteerMeasurement, SteerPlc
from tricycle_sim.plc.firmware import FirmwareDrivePlc, FirmwareSteerPlc
from tricycle_sim.plc.pair import PlcPair
from tricycle_sim.plc.simulated_uno import SimulatedUno

SESSION = 7
SUPPLY = {STEER: 12.0, DRIVE: 48.0}  # V


class InMemory:
    """The emulation, called directly; its wheel has a mass, its servo is where it shall be."""

    jitter = 0  # us by which a tick may come late
    simulated = True  # time, supply and the wheel are the test's

    def __init__(self, board, plc=None, *, start_us=0):
        self._plc = plc or (SteerPlc() if board is STEER else DrivePlc())
        self.wheel = Wheel()
        self._controller = SpeedController()
        self._torque = 0.0
        self._angle = 0.0
        self.now = start_us
        self._pressed = False
        self._supply = SUPPLY[board]
        self._lines = {}
        self._sent = b""
        self._tick()

    def write(self, data):
        self._sent += self._plc.receive(data, self.now)

    def run(self, seconds):
        for _ in range(round(100 * seconds)):
            self._tick()
        sent, self._sent = self._sent, b""
        return sent

    def _tick(self):
        if self._plc.board is STEER:
            steer = SteerMeasurement(self._angle, supply=self._supply, estop_pressed=self._pressed)
            sent, self._output = self._plc.tick(self.now, steer)
            self._angle = self._output.setpoint if self._output.servo_on else self._angle
        else:
            sent = self._tick_drive()
            for k in range(1, 11):
                at = self.now + 1000 * k
                self.wheel.move(1e-3, self._torque, self._output.brake, at)
        self._sent += sent
        self.now += 10_000

    def _tick_drive(self):
        wheel = self.wheel
        drive = DriveMeasurement(
            wheel.sensed_speed,
            wheel.count,
            self._torque,
            supply=self._supply,
            estop_pressed=self._pressed,
            **self._lines,
        )
        sent, self._output = self._plc.tick(self.now, drive)
        reverse = self._output.setpoint < 0.0
        self._torque = self._controller.torque(self._output, wheel.sensed_speed, reverse=reverse)
        return sent

    def press_estop(self, pressed):
        self._pressed = pressed

    def supply(self, volts):
        self._supply = volts

    def hall_lines(self, **volts):
        self._lines = volts

    def reset(self):
        self._plc.reset()

    def acts(self):
        output = self._output
        return output.servo_on if self._plc.board is STEER else output.motor_on

    def brake(self):
        return self._output.brake

    def close(self):
        pass


class Native(InMemory):
    """The firmware's C logic, with its own speed measurement and torque controller."""

    def __init__(self, board, libraries, **kwargs):
        kind = FirmwareSteerPlc if board is STEER else FirmwareDrivePlc
        super().__init__(board, kind(libraries / f"lib{board.name.lower()}.so"), **kwargs)

    def _tick_drive(self):
        sent, self._torque, self._output = self._plc.tick_pulses(
            self.now,
            self.wheel.count,
            self.wheel.edge_at,
            supply=self._supply,
            estop_pressed=self._pressed,
            **self._lines,
        )
        return sent


class OnPty:
    """The emulation behind a serial device, on the wall clock."""

    jitter = 100_000  # a busy machine's
    simulated = False

    def __init__(self, board, folder):
        self._board = board
        self._pair = PlcPair(folder / "steer", folder / "drive")
        path = self._pair.steer_path if board is STEER else self._pair.drive_path
        self._fd = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)

    def write(self, data):
        os.write(self._fd, data)

    def run(self, seconds):
        received, until = b"", time.monotonic() + seconds
        while (left := until - time.monotonic()) > 0:
            if select.select([self._fd], [], [], left)[0]:
                received += os.read(self._fd, 4096)
        return received

    def press_estop(self, pressed):
        self._pair.estop_pressed = pressed

    def reset(self):
        self._pair.reset(self._board)

    def acts(self):
        if self._board is STEER:
            return self._pair.steer_output.servo_on
        return self._pair.drive_output.motor_on

    def brake(self):
        return self._pair.drive_output.brake

    def close(self):
        os.close(self._fd)
        self._pair.close()


class OnUno:
    """The firmware's image; a servo follows its pulse, a mass is pushed by the motor."""

    jitter = 0
    simulated = True

    def __init__(self, board, images):
        self._board = board
        self._uno = SimulatedUno(images, board.name.lower())
        self._angle = 0.0
        self.wheel = Wheel()
        self._ms = 0
        self.run(0.05)

    def write(self, data):
        self._uno.write(data)

    def run(self, seconds):
        received = b""
        for _ in range(round(1000 * seconds)):
            self._ms += 1
            self._move()
            self._uno.run(self._ms * 1000)
            received += self._uno.read()
        return received

    def _move(self):
        if self._board is STEER:
            pins = self._uno.steer_pins()
            if pins.servo_on:
                self._angle += min(max(pins.angle - self._angle, -4e-3), 4e-3)
            self._uno.steering_angle(self._angle)
            return
        pins = self._uno.drive_pins()
        self.wheel.move(1e-3, pins.torque, pins.brake)
        self._uno.wheel_speed(self.wheel.sensed_speed)

    def press_estop(self, pressed):
        self._uno.estop(pressed=pressed)

    def supply(self, volts):
        self._uno.supply(volts)

    def hall_lines(self, *, hall_line=None, direction_line=None):
        self._uno.hall_lines(hall_line, direction_line)

    def reset(self):
        self._uno.reset()

    def acts(self):
        if self._board is STEER:
            return self._uno.steer_pins().servo_on
        return self._uno.drive_pins().torque != 0.0

    def brake(self):
        return self._uno.drive_pins().brake

    def close(self):
        self._uno.close()


class Host:
    """A host that sends exactly what a test says."""

    def __init__(self, board, plc):
        self.board = board
        self.plc = plc
        self.decoder = FrameDecoder(board, host=True)
        self.seq = 0
        self.operation = 0
        self.state = None
        self.received = []

    def send(self, message, *, board=None, seq=None, session=None, major=m.MAJOR):
        wire = self.encoded(message, board=board, seq=seq, session=session, major=major)
        self.plc.write(wire)

    def encoded(self, message, *, board=None, seq=None, session=None, major=m.MAJOR):
        self.seq = (self.seq + 1) & 0xFF if seq is None else seq
        session = self.decoder.session if session is None else session
        return encode(
            message, board=board or self.board, seq=self.seq, session=session, major=major
        )

    def run(self, seconds):
        """What came in that time."""
        messages = [frame.message for frame in self.decoder.feed(self.plc.run(seconds))]
        self.received += messages
        for message in messages:
            if isinstance(message, m.SteerState | m.DriveState):
                self.state = message
        return messages

    def ask(self, message, answer, **kwargs):
        """The answer of that type; None if there is none within half a second."""
        self.send(message, **kwargs)
        for _ in range(50):
            for received in self.run(0.01):
                if isinstance(received, answer):
                    return received
        return None

    def hello(self, *, wanted=None):
        self.decoder.session = SESSION
        wanted = wanted or self.board
        return self.ask(m.Hello(0, wanted, 99), m.HelloAck, board=wanted, session=SESSION)

    def set_up(self, **values):
        kind = SETUP[self.board]
        message = kind(**dict.fromkeys(m.layout(kind), 0) | values)
        return Result(self.ask(message, m.Ack).result)

    def limits(self):
        self.run(0.02)
        kind = m.SteerLimits if self.board is STEER else m.DriveLimits
        return self.ask(m.LimitsRequest(), kind)

    def command(self, value=0.0, *, flags=ENABLE, age_us=0, gear=m.Gear.DRIVE, brake=0):
        echo = m.echo_of((self.state.t - age_us) & 0xFFFFFFFF)
        if self.board is STEER:
            return m.SteerCommand(flags, 0, round(value * 1e4), 0, echo)
        return m.DriveCommand(flags, gear, round(value * 1e3), 0, brake, 0, echo)

    def stream(self, seconds, value=0.0, **kwargs):
        """A command every 20 ms."""
        for _ in range(round(50 * seconds)):
            self.send(self.command(value, **kwargs))
            self.run(0.02)

    def operation_of(self, op):
        """A new operation, as it would be sent now."""
        self.operation = (self.operation + 1) & 0xFF
        return m.Control.of(op, self.operation, m.echo_of(self.state.t))

    def control(self, op):
        return Result(self.ask(self.operation_of(op), m.Ack).result)

    def stats(self):
        self.run(0.02)  # a tick, so that there is room for the answer
        return self.ask(m.StatsRequest(), m.Stats)

    def arm(self):
        """Arm; on the wall clock again, where a busy machine made this stream pause."""
        for _ in range(10):
            self.stream(0.2)
            result = self.control(Op.ARM)
            self.stream(0.06)
            paused = result is Result.PRECONDITIONS or self.state.faults & m.Fault.CMD_TIMEOUT
            if not (self.plc.jitter and paused):
                break
            self.control(Op.CLEAR)
        assert result is Result.OK
        assert self.state.state == State.ARMED

    def value(self):
        """The measured angle or speed, rad or m/s."""
        is_steer = isinstance(self.state, m.SteerState)
        return self.state.angle * 1e-4 if is_steer else self.state.speed * 1e-3


@pytest.fixture(
    params=[
        "memory",
        pytest.param("native", marks=pytest.mark.slow),
        pytest.param("pty", marks=[pytest.mark.slow, pytest.mark.real_time]),
        pytest.param("uno", marks=pytest.mark.slow),
    ]
)
def make_plc(request, tmp_path):
    """Makes the PLC of a board on one of the backends."""
    if request.param == "memory":
        return InMemory
    if request.param == "native":
        libraries = request.getfixturevalue("firmware_libraries")
        return lambda board, **kwargs: Native(board, libraries, **kwargs)
    if request.param == "pty":
        return lambda board: OnPty(board, tmp_path)
    images = request.getfixturevalue("firmware_images")
    return lambda board: OnUno(board, images)


@pytest.fixture
def connect(make_plc):
    """Makes a host with a session on the PLC of a board; closes the PLC after the test."""
    plcs = []

    def connect(board, **kwargs):
        plcs.append(make_plc(board, **kwargs))
        host = Host(board, plcs[-1])
        assert host.hello() is not None
        host.run(0.05)
        return host

    yield connect
    for plc in plcs:
        plc.close()


@pytest.fixture(params=[STEER, DRIVE], ids=["steer", "drive"])
def unset(request, connect):
    """With a session, without a SETUP."""
    return connect(request.param)


@pytest.fixture
def host(unset):
    assert unset.set_up() is Result.OK
    return unset


@pytest.fixture
def armed(host):
    host.arm()
    return host


@pytest.fixture
def drive(connect):
    """A drive PLC that knows the vehicle's mass by 10 %."""
    host = connect(DRIVE)
    assert host.set_up(mass_low=round(9 * MASS), mass_high=round(11 * MASS)) is Result.OK
    return host


@pytest.fixture
def rolling(drive):
    """The same with a wheel that the test may break, tow and tilt."""
    if not drive.plc.simulated:
        pytest.skip("its wheel is the pair's")
    return drive


def test_it_says_who_it_is_and_streams_its_state(host):
    ack = host.hello()
    assert (ack.board, ack.nonce, ack.watchdog) == (host.board, 99, 200)
    states = [x for x in host.run(0.5) if isinstance(x, m.SteerState | m.DriveState)]
    assert len(states) > 20  # of some 50: by the board's clock, which a busy machine does not stop
    assert states[-1].t - states[0].t == pytest.approx(10_000 * (len(states) - 1), abs=20_000)
    assert states[-1].state == State.SAFE


def test_it_answers_for_itself_and_for_any_board_only(host):
    other = DRIVE if host.board is STEER else STEER
    assert host.hello(wanted=other) is None
    assert host.hello(wanted=m.Board.ANY).board == host.board


def test_only_a_stream_of_enabled_commands_lets_it_arm(host):
    assert host.control(Op.ARM) is Result.PRECONDITIONS
    host.stream(0.2, flags=0)
    assert host.control(Op.ARM) is Result.PRECONDITIONS
    host.arm()
    host.stream(0.1, 0.2)
    assert host.plc.acts()


def test_it_follows_its_set_point(armed):
    for _ in range(50):  # 2 s at most
        armed.stream(0.04, 0.3)
        if armed.value() == pytest.approx(0.3, abs=0.01):
            break
    assert armed.value() == pytest.approx(0.3, abs=0.01)
    assert armed.state.setpoint == (3000 if armed.board is STEER else 300)


def test_a_command_outside_the_limits_is_limited_and_said_to_be(armed):
    armed.stream(0.5, 3.0 if armed.board is STEER else 9.0)
    assert armed.state.faults == Fault.LIMIT
    assert armed.state.setpoint <= (7461 if armed.board is STEER else 4800)
    armed.stream(0.1, 0.1)
    assert armed.state.faults == 0
    assert armed.state.state == State.ARMED


def test_silence_stops_it_and_only_an_operator_starts_it_again(armed):
    armed.stream(0.3, 0.2)
    armed.received.clear()
    armed.run(0.3)
    states = [x for x in armed.received if isinstance(x, m.SteerState | m.DriveState)]
    # ages are told in whole ticks: the newest command came at this time, or up to a tick before
    accepted = next(s.t - 10_000 * s.command_age for s in states if s.command_age < 10)
    trip = next(x for x in armed.received if isinstance(x, m.Event))
    assert (trip.states, trip.faults) == (State.ARMED << 4 | State.STOPPING, Fault.CMD_TIMEOUT)
    assert 190_000 <= trip.t - accepted <= 210_000 + armed.plc.jitter
    armed.run(1.5)
    armed.stream(0.2, flags=ENABLE | STANDSTILL)
    assert armed.state.state == State.SAFE
    assert not armed.plc.acts()
    assert armed.control(Op.ARM) is Result.WRONG_STATE
    assert armed.stats().watchdog_trips == 1
    assert armed.control(Op.CLEAR) is Result.OK
    armed.arm()


def test_an_old_command_moves_nothing(armed):
    before = armed.state.setpoint
    armed.stream(0.4, 0.3, age_us=200_000)
    assert armed.state.state in (State.STOPPING, State.SAFE)
    assert armed.state.faults == Fault.CMD_TIMEOUT
    assert armed.state.setpoint == pytest.approx(before, abs=30)  # a count of the potentiometer
    assert armed.stats().stale >= 15


def test_enable_zero_stops_it_without_a_fault(armed):
    armed.stream(0.5, 0.2)
    armed.stream(1.0, 0.2, flags=0)
    armed.stream(0.5, 0.2, flags=STANDSTILL)
    assert (armed.state.state, armed.state.faults) == (State.SAFE, 0)
    assert not armed.plc.acts()


@pytest.mark.parametrize("how", ["operation", "flag", "pin"])
def test_every_emergency_stop_latches(armed, how):
    armed.stream(0.3, 0.2)
    if how == "operation":
        assert armed.control(Op.ESTOP) is Result.OK
    elif how == "flag":
        armed.send(armed.command(0.2, flags=ENABLE | ESTOP))
    else:
        armed.plc.press_estop(True)
    armed.run(0.05)
    assert armed.state.state == State.ESTOP
    assert armed.state.faults == (Fault.ESTOP_HW if how == "pin" else Fault.ESTOP_HOST)
    assert_outputs_are_safe(armed)
    if how == "pin":
        assert armed.control(Op.CLEAR) is Result.PRECONDITIONS
        armed.plc.press_estop(False)
        armed.run(0.05)
    armed.stream(0.2)
    assert armed.state.state == State.ESTOP
    assert armed.control(Op.ARM) is Result.WRONG_STATE
    assert armed.control(Op.CLEAR) is Result.OK
    armed.run(0.02)
    assert (armed.state.state, armed.state.faults) == (State.SAFE, 0)


def assert_outputs_are_safe(host):
    """Motor off, brake full; the servo holds."""
    if host.board is DRIVE:
        assert not host.plc.acts()
        assert host.plc.brake() == pytest.approx(1.0, abs=0.01)
    else:
        assert host.plc.acts()
        assert host.state.flags & m.StateFlag.HOLDING


def test_disarm_and_hello_take_its_outputs_away_at_once(armed):
    assert armed.control(Op.DISARM) is Result.OK
    armed.run(0.02)
    assert armed.state.state == State.SAFE
    assert_outputs_are_safe(armed)
    armed.run(1.0)  # until the wheel rests
    armed.arm()
    armed.hello()
    armed.run(0.02)
    assert armed.state.state == State.SAFE
    assert_outputs_are_safe(armed)


def test_a_reset_forgets_the_session_and_counts_the_boot(armed):
    boots = armed.hello().boot_count
    assert armed.set_up() is Result.OK
    armed.arm()
    armed.plc.reset()
    armed.received.clear()
    armed.stream(0.3, 0.2)
    assert any(isinstance(x, m.Event) and x.code == m.EventCode.BOOT for x in armed.received)
    assert armed.state.state == State.SAFE
    assert not armed.plc.acts()
    assert armed.hello().boot_count == boots + 1
    assert armed.stats().session >= 10


def test_damage_is_counted_and_changes_nothing(armed):
    before = armed.stats()
    good = 0
    for k in range(20):
        wire = armed.encoded(armed.command(0.5))
        flipped = bytearray(wire)
        flipped[1 + k % 8] ^= 0x80  # makes no zero of a code byte that is no zero
        armed.seq -= 1  # it never came
        armed.plc.write(bytes(flipped).replace(b"\0", b"\xff") + b"\0")
        armed.plc.write(b"\0\0" + wire[: k % 10 + 2] + b"\0")  # truncated, after empty segments
        armed.plc.write(b"\xaa" * 60 + b"\0")  # too long
        ok = armed.encoded(armed.command(0.0))
        armed.plc.write(ok + ok)  # duplicated
        good += 2
        armed.run(0.02)
    stats = armed.stats()
    assert armed.state.state == State.ARMED
    assert abs(armed.value()) < 0.03
    rejected = sum(getattr(stats, f) - getattr(before, f) for f in ("crc", "cobs", "length"))
    assert rejected == 60
    assert stats.duplicate - before.duplicate == 20
    assert stats.ok - before.ok == good + 1  # and the request of these counters
    assert stats.seq_gap == before.seq_gap


def test_frames_for_others_are_counted_each_in_its_kind(armed):
    before = armed.stats()
    command, seq = armed.command(0.5), armed.seq
    other = DRIVE if armed.board is STEER else STEER
    armed.send(command, session=SESSION + 1)
    armed.send(command, major=1)
    armed.send(command, board=other)
    armed.send(m.Pong(1, 2, 3))  # what only a PLC sends
    armed.seq = seq
    after = armed.stats()
    assert after.session - before.session == 1
    assert after.version - before.version == 1
    assert after.unknown - before.unknown == 2
    assert abs(armed.value()) < 0.03


def test_a_ping_tells_the_clock(host):
    before = host.state.t
    pong = host.ask(m.Ping(0x01020304), m.Pong)
    assert pong.token == 0x01020304
    host.run(0.03)
    assert before <= pong.t_rx <= pong.t_tx <= host.state.t


# ---- what a line may replay, flood or cut ----


def test_a_recorded_clear_and_arm_do_nothing_later(armed):
    recorded = [armed.encoded(armed.operation_of(op)) for op in (Op.CLEAR, Op.ARM)]
    assert armed.control(Op.ESTOP) is Result.OK
    armed.stream(0.1)
    for wire in recorded:
        armed.plc.write(wire)
        armed.stream(0.06)
    answers = [Result(x.result) for x in armed.received if isinstance(x, m.Ack)]
    assert answers[-2:] == [Result.STALE, Result.STALE]
    assert (armed.state.state, armed.state.faults) == (State.ESTOP, Fault.ESTOP_HOST)


def test_a_clear_out_of_a_buffer_is_stale(armed):
    assert armed.control(Op.ESTOP) is Result.OK
    late = armed.operation_of(Op.CLEAR)
    armed.run(0.3)
    assert armed.ask(late, m.Ack).result == Result.STALE
    armed.run(0.02)
    assert armed.state.state == State.ESTOP
    assert armed.stats().stale >= 1
    assert armed.control(Op.CLEAR) is Result.OK


def test_a_repeated_operation_is_carried_out_once(host):
    host.stream(0.2)
    arm = host.operation_of(Op.ARM)
    first = host.ask(arm, m.Ack).result
    assert host.control(Op.ESTOP) is Result.OK
    host.stream(0.06)
    assert host.control(Op.CLEAR) is Result.OK
    clear = m.Control.of(Op.CLEAR, host.operation, m.echo_of(host.state.t))
    host.send(host.command(flags=ENABLE | ESTOP))
    host.run(0.05)
    assert host.ask(clear, m.Ack).result == Result.OK  # the first one's
    host.run(0.05)
    assert host.state.state == State.ESTOP
    assert host.ask(arm, m.Ack).result == Result.STALE
    assert first == Result.OK or host.plc.jitter


def test_a_flood_of_pings_takes_no_telemetry_away(armed):
    armed.stream(0.1)
    before = len(armed.received)
    for _ in range(50):
        armed.send(armed.command())
        for token in range(7):
            armed.send(m.Ping(token))
        armed.run(0.02)
    flood = armed.received[before:]
    assert sum(isinstance(x, m.SteerState | m.DriveState) for x in flood) >= 95
    assert sum(isinstance(x, m.Pong) for x in flood) <= 4 * 51 + armed.plc.jitter
    assert armed.state.state == State.ARMED


def test_the_event_of_a_boot_is_heard_behind_a_cut_frame(host):
    host.run(0.02)
    host.received.clear()
    host.plc.reset()
    host.decoder.feed(b"\x1f\x31\x90 cut off by the reset")
    host.run(0.5)
    event, *_ = [x for x in host.received if isinstance(x, m.Event)]
    assert event.code == m.EventCode.BOOT


# ---- the vehicle's values ----


def test_nothing_arms_without_a_setup(unset):
    unset.stream(0.2)
    assert not unset.state.flags & m.StateFlag.SET_UP
    assert unset.control(Op.ARM) is Result.PRECONDITIONS
    assert unset.set_up() is Result.OK
    unset.stream(0.06)
    assert unset.state.flags & m.StateFlag.SET_UP
    unset.arm()


def test_a_setup_only_tightens_and_holds_for_its_session(unset):
    steers = unset.board is STEER
    name, own = ("max_angle", 7461) if steers else ("max_speed", 4800)
    most = 3000
    assert unset.set_up(**{name: own + 1}) is Result.OUT_OF_RANGE
    assert getattr(unset.limits(), name) == own
    assert unset.set_up(**{name: most}) is Result.OK
    assert unset.set_up(**{name: most}) is Result.OK
    assert unset.set_up(**{name: most + 1}) is Result.WRONG_STATE
    assert getattr(unset.limits(), name) == most
    unset.arm()
    assert unset.set_up(**{name: most}) is Result.WRONG_STATE
    unset.stream(2.0, 0.5 if steers else 4.0)
    assert unset.state.setpoint == most
    assert unset.state.faults == Fault.LIMIT
    unset.hello()
    unset.run(0.05)
    assert getattr(unset.limits(), name) == own
    assert not unset.state.flags & m.StateFlag.SET_UP


def test_a_limited_command_is_told_while_it_is_not_armed(host):
    host.stream(0.1, 3.0 if host.board is STEER else 9.0)
    assert (host.state.state, host.state.faults) == (State.SAFE, Fault.LIMIT)
    host.run(0.4)
    assert host.state.faults == 0


def test_a_wrong_supply_is_told_and_blocks_arming(unset):
    if not unset.plc.simulated:
        pytest.skip("its supply is right")
    rated = SUPPLY[unset.board]
    assert unset.set_up(supply_low=round(900 * rated), supply_high=round(1100 * rated)) is Result.OK
    unset.plc.supply(0.8 * rated)
    unset.stream(0.2)
    assert unset.state.faults == Fault.SUPPLY
    assert unset.control(Op.ARM) is Result.PRECONDITIONS
    assert unset.control(Op.CLEAR) is Result.OK
    assert unset.control(Op.ARM) is Result.PRECONDITIONS
    unset.plc.supply(rated)
    unset.stream(0.2)
    assert unset.state.faults == 0
    unset.arm()
    unset.plc.supply(1.2 * rated)
    unset.stream(0.2)
    assert (unset.state.state, unset.state.faults) == (State.ARMED, Fault.SUPPLY)


# ---- the steering holds ----


@pytest.mark.parametrize("how", [Op.DISARM, Op.ESTOP, "silence"])
def test_the_steering_holds_until_the_host_says_standstill(connect, how):
    steer = connect(STEER)
    steer.set_up()
    steer.arm()
    steer.stream(0.5, 0.3)
    if how == "silence":
        steer.run(0.4)
    else:
        assert steer.control(how) is Result.OK
    steer.stream(0.4, -0.3, flags=0)
    held = {Op.DISARM: State.SAFE, Op.ESTOP: State.ESTOP, "silence": State.STOPPING}[how]
    assert (steer.state.state, steer.state.setpoint) == (held, 3000)
    assert steer.state.flags & m.StateFlag.HOLDING
    assert steer.state.servo == 1691
    assert steer.plc.acts()
    steer.stream(0.1, flags=STANDSTILL)
    assert steer.state.state == (State.ESTOP if how is Op.ESTOP else State.SAFE)
    assert not steer.state.flags & m.StateFlag.HOLDING
    assert steer.state.servo == 0
    assert not steer.plc.acts()


def test_the_steering_holds_for_ten_seconds_at_most(connect):
    steer = connect(STEER)
    if not steer.plc.simulated:
        pytest.skip("ten seconds")
    steer.set_up()
    steer.arm()
    steer.stream(0.3, 0.2)
    assert steer.control(Op.DISARM) is Result.OK
    steer.run(9.8)
    assert steer.plc.acts()
    steer.run(0.4)
    assert not steer.plc.acts()


# ---- the wheel ----


def test_an_armed_vehicle_at_rest_is_held_by_its_brake(drive):
    drive.arm()
    drive.stream(0.1)
    assert drive.state.flags & m.StateFlag.HOLDING
    assert drive.plc.brake() == pytest.approx(1.0, abs=0.01)
    assert not drive.plc.acts()
    drive.stream(0.2, 0.3)
    assert not drive.state.flags & m.StateFlag.HOLDING
    assert drive.plc.brake() == 0.0
    assert drive.plc.acts()


@pytest.mark.parametrize("brake", [1, 200])
def test_a_commanded_brake_stops_it_without_the_motor(rolling, brake):
    rolling.arm()
    for _ in range(2):
        rolling.stream(3.0, 1.5)
        assert rolling.plc.wheel.speed == pytest.approx(1.5, abs=0.2)
        rolling.stream(0.1, 1.5, brake=brake)
        assert rolling.state.pwm == 0
        rolling.stream(2.9, 1.5, brake=brake)
        assert (rolling.state.state, rolling.state.faults) == (State.ARMED, 0)
        assert rolling.state.flags & m.StateFlag.HOLDING
        assert rolling.plc.wheel.speed == 0.0
    rolling.plc.wheel.sensed = HALL_SENSORS["no pulses"]
    at = rolling.plc.wheel.travel
    rolling.stream(3.0, 1.5, brake=brake)
    assert rolling.plc.wheel.travel == at


def test_a_vehicle_that_rolls_is_not_armed(rolling):
    rolling.plc.wheel.towed = 0.15
    rolling.stream(0.4)
    assert rolling.control(Op.ARM) is Result.PRECONDITIONS
    assert rolling.plc.brake() == pytest.approx(1.0, abs=0.01)
    rolling.plc.wheel.towed = None
    rolling.stream(0.5)
    assert rolling.control(Op.ARM) is Result.OK


def test_stopping_brakes_downhill(rolling):
    rolling.arm()
    rolling.stream(2.0, 1.5)
    rolling.plc.wheel.slope = 2.5  # steeper than the motor holds
    rolling.stream(0.5, 1.5, flags=0)
    assert rolling.state.brake > 50
    rolling.plc.wheel.slope = 0.5
    brake = rolling.state.brake
    rolling.stream(4.0, 1.5, flags=0)
    assert (rolling.state.state, rolling.state.speed, rolling.state.faults) == (State.SAFE, 0, 0)
    assert brake > 50


def test_stopping_gives_up_after_eight_seconds(rolling):
    rolling.arm()
    rolling.stream(1.5, 1.0)
    rolling.plc.wheel.towed = 1.0
    rolling.stream(7.5, 1.0, flags=0)
    assert (rolling.state.state, rolling.state.brake) == (State.STOPPING, 200)
    rolling.stream(1.0, 1.0, flags=0)
    assert (rolling.state.state, rolling.state.faults) == (State.FAULT, Fault.STOP_TIMEOUT)
    assert not rolling.plc.acts()


@pytest.mark.parametrize("value", [0.25, 1.0, 4.0])
@pytest.mark.parametrize(
    ("sensor", "gear"),
    [
        ("no pulses", m.Gear.DRIVE),
        ("no pulses", m.Gear.REVERSE),
        ("direction reads forward", m.Gear.REVERSE),
        ("direction reads backward", m.Gear.DRIVE),
    ],
)
def test_a_stuck_hall_sensor_is_found(rolling, sensor, gear, value):
    wheel = rolling.plc.wheel
    wheel.sensed = HALL_SENSORS[sensor]
    rolling.arm()
    for _ in range(150):  # 3 s
        rolling.stream(0.02, value, gear=gear)
        if rolling.state.state != State.ARMED:
            break
    assert (rolling.state.state, rolling.state.faults) == (State.FAULT, Fault.PULSES)
    assert rolling.plc.brake() == pytest.approx(1.0, abs=0.01)
    assert wheel.fastest < 1.2


@pytest.mark.parametrize("value", [0.25, 1.0, 4.0])
def test_a_hall_sensor_that_sticks_on_the_way_is_found(rolling, value):
    wheel = rolling.plc.wheel
    rolling.arm()
    rolling.stream(3.0, value)
    at = wheel.travel
    wheel.sensed = lambda travel: min(travel, at)
    rolling.stream(3.0, value)
    assert (rolling.state.state, rolling.state.faults) == (State.FAULT, Fault.PULSES)
    assert wheel.fastest < value + 0.8


def rearm(host):
    assert host.control(Op.DISARM) is Result.OK
    host.arm()


PAUSES = {
    "brake": (1.5, 0.7, lambda host: host.stream(0.02, 1.5, brake=1)),
    "speed": (1.5, 0.3, lambda host: host.stream(0.4, 0.0)),
    "gear": (1.5, 0.3, lambda host: host.stream(0.4, 1.5, gear=m.Gear.NEUTRAL)),
    "arming": (1.5, 0.7, rearm),
    "slow": (0.09, 1.0, lambda host: host.stream(0.02, 0.09, brake=1)),
}


@pytest.mark.parametrize("pause", PAUSES)
def test_a_host_that_pauses_does_not_drive_a_wheel_without_its_sensor_on(rolling, pause):
    wheel = rolling.plc.wheel
    wheel.sensed = HALL_SENSORS["no pulses"]
    value, seconds, wait = PAUSES[pause]
    rolling.arm()
    for _ in range(20):
        rolling.stream(seconds, value)
        if rolling.state.state != State.ARMED:
            break
        wait(rolling)
    assert rolling.state.faults == (0 if pause == "slow" else Fault.PULSES)
    assert wheel.fastest < 1.2


def test_a_wheel_that_hung_for_a_moment_starts_when_the_brake_has_held_it(rolling):
    wheel = rolling.plc.wheel
    rolling.arm()
    wheel.towed = 0.0
    rolling.stream(0.5, 1.0)
    rolling.stream(0.1, 1.0, brake=1)
    wheel.towed = None
    rolling.stream(1.5, 1.0)
    assert rolling.state.flags & m.StateFlag.HOLDING
    assert wheel.speed == 0.0
    rolling.stream(2.5, 1.0)
    assert (rolling.state.state, rolling.state.faults) == (State.ARMED, 0)
    assert wheel.speed == pytest.approx(1.0, abs=0.2)


LINES = [
    {"hall_line": 5.0},  # broken
    {"hall_line": 0.0},  # shorted to ground
    {"hall_line": 2.5},  # to the other one, which has the other level
    {"direction_line": 5.0},
    {"direction_line": 0.0},
]


@pytest.mark.parametrize("volts", LINES)
@pytest.mark.parametrize("value", [0.0, 0.25, 4.0])
def test_a_wire_of_the_hall_sensor_that_breaks_is_found_at_once(rolling, value, volts):
    rolling.arm()
    rolling.stream(2.0, value)
    speed = rolling.plc.wheel.speed
    rolling.plc.hall_lines(**volts)
    rolling.received.clear()
    rolling.stream(0.06, value)
    assert rolling.state.state == State.FAULT
    assert rolling.state.faults & Fault.HALL_LINE
    assert_outputs_are_safe(rolling)
    assert rolling.plc.wheel.fastest < speed + 0.1
    assert rolling.control(Op.CLEAR) is Result.OK
    rolling.stream(0.2)
    assert (rolling.state.state, rolling.state.faults) == (State.SAFE, Fault.HALL_LINE)
    assert rolling.control(Op.ARM) is Result.WRONG_STATE


@pytest.mark.parametrize("volts", LINES)
def test_a_broken_wire_of_the_hall_sensor_blocks_arming(rolling, volts):
    rolling.plc.hall_lines(**volts)
    rolling.stream(0.2)
    assert (rolling.state.state, rolling.state.faults) == (State.SAFE, Fault.HALL_LINE)
    assert rolling.control(Op.ARM) is Result.WRONG_STATE
    rolling.plc.hall_lines()
    rolling.stream(0.1)
    assert rolling.control(Op.CLEAR) is Result.OK
    rolling.arm()


@pytest.mark.parametrize("gear", [m.Gear.DRIVE, m.Gear.REVERSE])
def test_an_armed_vehicle_that_its_motor_does_not_hold_is_braked(rolling, gear):
    wheel = rolling.plc.wheel
    rolling.arm()
    rolling.stream(2.0, 0.5, gear=gear)
    wheel.slope = 1.1 if gear is m.Gear.DRIVE else -1.1
    rolling.stream(3.0, 0.5, gear=gear)
    assert rolling.state.state == State.FAULT
    assert rolling.state.faults in (Fault.OVERSPEED, Fault.PULSES)
    assert wheel.fastest < 1.0


@pytest.mark.parametrize("slope", [-0.5, 0.5])
@pytest.mark.parametrize(("value", "gear"), [(0.25, m.Gear.DRIVE), (1.5, m.Gear.REVERSE)])
def test_a_healthy_wheel_on_a_slope_is_no_fault(rolling, value, gear, slope):
    rolling.plc.wheel.slope = slope
    rolling.arm()
    for target in (value, 0.0, value):
        rolling.stream(2.0, target, gear=gear)
        assert (rolling.state.state, rolling.state.faults) == (State.ARMED, 0)


def test_a_change_of_direction_on_a_slope_keeps_the_torque_that_holds_the_vehicle(rolling):
    wheel = rolling.plc.wheel
    wheel.slope = -0.5
    rolling.arm()
    rolling.stream(3.0, 0.5)
    rolling.stream(0.5, 0.3, gear=m.Gear.REVERSE)
    assert wheel.speed < 0.2
    wheel.fastest = 0.0
    rolling.stream(2.5, 0.3, gear=m.Gear.REVERSE)
    assert rolling.state.gear == m.Gear.REVERSE
    assert wheel.fastest < 0.45  # 0.48 with the torque turned round


# ---- the clock ----


@pytest.fixture
def late(connect, request):
    """Makes a host of a board whose clock wraps in 3 s."""
    if request.node.callspec.params["make_plc"] not in ("memory", "native"):
        pytest.skip("its clock begins at zero")

    def late(board):
        host = connect(board, start_us=(1 << 32) - 3_000_000)
        assert host.set_up() is Result.OK
        return host

    return late


@pytest.mark.parametrize("board", [STEER, DRIVE])
def test_no_wrap_of_the_clock_stops_anything(late, board):
    host = late(board)
    host.arm()
    host.stream(5.0, 0.3)
    assert host.state.t < 3_000_000
    assert (host.state.state, host.state.faults) == (State.ARMED, 0)
    assert host.value() == pytest.approx(0.3, abs=0.02)


@pytest.mark.parametrize("since", [1_000_000, 4_000_000, 10_000_000])
def test_a_wheel_at_rest_does_not_move_a_wrap_of_the_clock_after_its_last_pulse(late, since):
    host = late(DRIVE)
    host.arm()
    host.stream(1.0, 0.5)
    host.stream(1.0, 0.0)
    assert host.control(Op.DISARM) is Result.OK
    host.run(1e-6 * since)
    host.plc.now += (1 << 32) - since
    for _ in range(50):
        host.run(0.01)
        assert (host.state.state, host.state.speed) == (State.SAFE, 0)
