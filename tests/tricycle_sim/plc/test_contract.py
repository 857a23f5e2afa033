"""One contract for everything that speaks the protocol as a PLC, met over its line alone.

Backends: the emulation in memory, the emulation on a pty in real time, and the flashed firmware on
a simulated ATmega328P. A host sends frames and reads what comes back; nothing else is looked at but
the actuators. (test_plc.py looks closer, at the emulation and at the firmware's C logic.)
"""

import os
import select
import time

import pytest

from tricycle_bridge.protocol import messages as m
from tricycle_bridge.protocol.framing import FrameDecoder, encode
from tricycle_sim.plc import DriveMeasurement, DrivePlc, SteerMeasurement, SteerPlc
from tricycle_sim.plc.pair import PlcPair
from tricycle_sim.plc.simulated_uno import SimulatedUno

ENABLE, ESTOP = m.CommandFlag.ENABLE, m.CommandFlag.ESTOP
STEER, DRIVE = m.Board.STEER, m.Board.DRIVE
State, Fault, Op, Result = m.PlcState, m.Fault, m.Op, m.Result
SESSION = 7
MASS_AT_TREAD = 48.3 * 0.335  # N s^2: torque over this is acceleration


class InMemory:
    """The emulation, called directly; its plant is where its set-point is."""

    jitter = 0  # us by which a tick may come late

    def __init__(self, board):
        self._plc = SteerPlc() if board is STEER else DrivePlc()
        self._now = 0
        self._pressed = False
        self._value = 0.0
        self._sent = b""
        self._tick()

    def write(self, data):
        self._sent += self._plc.receive(data, self._now)

    def run(self, seconds):
        for _ in range(round(100 * seconds)):
            self._tick()
        sent, self._sent = self._sent, b""
        return sent

    def _tick(self):
        measured = (SteerMeasurement if isinstance(self._plc, SteerPlc) else DriveMeasurement)(
            self._value, estop_pressed=self._pressed
        )
        sent, self._output = self._plc.tick(self._now, measured)
        self._sent += sent
        self._value = self._output.setpoint
        self._now += 10_000

    def press_estop(self, pressed):
        self._pressed = pressed

    def reset(self):
        self._plc.reset()

    def acts(self):
        output = self._output
        return output.servo_on if isinstance(self._plc, SteerPlc) else output.brake < 1.0

    def close(self):
        pass


class OnPty:
    """The emulation behind a serial device, on the wall clock."""

    jitter = 100_000  # a busy machine's

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
        return self._pair.drive_output.brake < 1.0

    def close(self):
        os.close(self._fd)
        self._pair.close()


class OnUno:
    """The firmware's image; a servo follows its pulse, a mass is pushed by the motor."""

    jitter = 0

    def __init__(self, board, images):
        self._board = board
        self._uno = SimulatedUno(images, board.name.lower())
        self._angle = self._speed = 0.0
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
        self._speed += 1e-3 * pins.torque / MASS_AT_TREAD
        braked = 1e-3 * 25.0 * pins.brake / MASS_AT_TREAD
        self._speed = max(self._speed - braked, min(self._speed + braked, 0.0))
        self._uno.wheel_speed(self._speed)

    def press_estop(self, pressed):
        self._uno.estop(pressed=pressed)

    def reset(self):
        self._uno.reset()

    def acts(self):
        if self._board is STEER:
            return self._uno.steer_pins().servo_on
        return self._uno.drive_pins().brake < 1.0

    def close(self):
        self._uno.close()


class Host:
    """A host that sends exactly what a test says."""

    def __init__(self, board, plc):
        self.board = board
        self.plc = plc
        self.decoder = FrameDecoder(board, host=True)
        self.seq = 0
        self.state = None
        self.received = []

    def send(self, message, *, board=None, seq=None, session=None, major=1):
        wire = self.encoded(message, board=board, seq=seq, session=session, major=major)
        self.plc.write(wire)

    def encoded(self, message, *, board=None, seq=None, session=None, major=1):
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

    def command(self, value=0.0, *, flags=ENABLE, age_us=0):
        echo = m.echo_of((self.state.t - age_us) & 0xFFFFFFFF)
        if self.board is STEER:
            return m.SteerCommand(flags, 0, round(value * 1e4), 0, echo)
        return m.DriveCommand(flags, m.Gear.DRIVE, round(value * 1e3), 0, 0, 0, echo)

    def stream(self, seconds, value=0.0, **kwargs):
        """A command every 20 ms."""
        for _ in range(round(50 * seconds)):
            self.send(self.command(value, **kwargs))
            self.run(0.02)

    def control(self, op):
        return Result(self.ask(m.Control.of(op), m.Ack).result)

    def stats(self):
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
        pytest.param("pty", marks=pytest.mark.slow),
        pytest.param("uno", marks=pytest.mark.slow),
    ]
)
def make_plc(request, tmp_path):
    """Makes the PLC of a board on one of the backends."""
    if request.param == "memory":
        return InMemory
    if request.param == "pty":
        return lambda board: OnPty(board, tmp_path)
    images = request.getfixturevalue("firmware_images")
    return lambda board: OnUno(board, images)


@pytest.fixture(params=[STEER, DRIVE], ids=["steer", "drive"])
def host(request, make_plc):
    plc = make_plc(request.param)
    host = Host(request.param, plc)
    assert host.hello() is not None
    host.run(0.05)
    yield host
    plc.close()


@pytest.fixture
def armed(host):
    host.arm()
    return host


def test_it_says_who_it_is_and_streams_its_state(host):
    ack = host.hello()
    assert (ack.board, ack.nonce, ack.watchdog) == (host.board, 99, 200)
    states = [x for x in host.run(0.5) if isinstance(x, m.SteerState | m.DriveState)]
    assert len(states) == pytest.approx(50, abs=5)
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
    assert armed.state.setpoint <= (7854 if armed.board is STEER else 4800)
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
    armed.stream(0.2)
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
    armed.stream(1.5, 0.2, flags=0)
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
    assert not armed.plc.acts()
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


def test_disarm_and_hello_take_its_outputs_away_at_once(armed):
    assert armed.control(Op.DISARM) is Result.OK
    armed.run(0.02)
    assert armed.state.state == State.SAFE
    assert not armed.plc.acts()
    armed.run(1.0)  # until the wheel rests
    armed.arm()
    armed.hello()
    armed.run(0.02)
    assert armed.state.state == State.SAFE


def test_a_reset_forgets_the_session_and_counts_the_boot(armed):
    boots = armed.hello().boot_count
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
    armed.send(command, major=2)
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
