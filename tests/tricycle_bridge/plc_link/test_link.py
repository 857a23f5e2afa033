"""The host's side of one link against the emulated PLC, on a simulated clock."""

import dataclasses
import itertools
import random

import pytest

from tricycle_bridge.plc_link.link import LinkEventKind, LinkState, PlcLink
from tricycle_bridge.protocol import messages as m
from tricycle_bridge.protocol.framing import FrameDecoder, encode
from tricycle_sim.plc import DriveMeasurement, DrivePlc, SteerMeasurement, SteerPlc

Kind = LinkEventKind
SETUPS = {
    m.Board.STEER: m.SteerSetup(7000, 2000, 10_000, 14_000),
    m.Board.DRIVE: m.DriveSetup(
        3000, 1000, 15253, 3350, 3500, 1500, 250, 500, 700, 40_000, 60_000, 0, 0
    ),
}


class Line:
    """A link and a PLC with a simulated clock and a cable that can be cut or noisy."""

    def __init__(self, plc=None, *, board=m.Board.STEER, boot_wait=0.0, start_us=0):
        self.plc = plc or SteerPlc()
        self.link = PlcLink(board, rng=random.Random(1), boot_wait=boot_wait, setup=SETUPS[board])
        self.now = 100.0
        self.start_us = start_us
        self.events = []
        self.to_plc = lambda data: data
        self.to_host = lambda data: data
        self.sent = []  # (time, message), as the PLC would decode them
        self._listener = FrameDecoder(board, host=False)
        self.commanding = False
        steer = self.plc.board is m.Board.STEER
        self.measurement = SteerMeasurement() if steer else DriveMeasurement()
        self.plc.tick(self.now_us, self.measurement)  # booted before the host came
        self.link.opened(self.now)

    @property
    def now_us(self):
        return self.start_us + round((self.now - 100.0) * 1e6)

    def kinds(self):
        return [e.kind for e in self.events if e.kind is not Kind.TELEMETRY]

    def texts(self, kind):
        return [e.text for e in self.events if e.kind is kind]

    def step(self, ticks=1):
        for _ in range(ticks):
            self.now += 0.01
            if self.commanding:
                command = m.SteerCommand(1, 0, 0, 0, 0)
                if self.plc.board is m.Board.DRIVE:
                    command = m.DriveCommand(1, 1, 0, 0, 0, 0, 0)
                self.link.send_command(command)
            self.events += self.link.poll(self.now)
            data = b"".join(self.link.take_frames())
            self._listener.session = self.link.decoder.session
            self.sent += [(self.now, frame.message) for frame in self._listener.feed(data)]
            answer = self.plc.receive(self.to_plc(data), self.now_us)
            telemetry, _ = self.plc.tick(self.now_us, self.measurement)
            self.events += self.link.receive(self.to_host(answer + telemetry), self.now)

    def sent_of(self, kind):
        return [message for _, message in self.sent if isinstance(message, kind)]

    def control(self, op):
        self.link.operate(op, self.now)
        self.step(30)
        return [e.operation.result for e in self.events if e.operation][-1]


def test_the_link_is_up_within_a_tick_of_the_first_hello():
    line = Line()
    line.step(2)
    assert line.kinds() == [Kind.UP]
    assert line.texts(Kind.UP) == ["steer PLC: firmware 2.0.0, boot 1, last reset: power-on"]
    line.step(40)
    assert line.link.set_up
    assert line.link.limits.max_angle == 7000  # in force
    assert line.link.stats is not None
    assert line.link.clock.round_trip == pytest.approx(0.0, abs=1e-6)


def test_it_stays_quiet_while_the_bootloader_listens():
    line = Line(boot_wait=2.0)
    line.step(199)
    assert line.link.counters.sent == 0
    line.step(4)
    assert line.link.up


def test_silence_is_reported_after_three_seconds_with_the_counters():
    line = Line()
    line.to_host = lambda data: b""
    line.step(310)
    assert line.kinds() == [Kind.SILENT]
    assert line.link.problem.startswith("no steer PLC answers (")
    assert "HELLO sent, 0 good frames" in line.link.problem


def test_swapped_ports_are_told_and_the_board_gets_no_command():
    line = Line(DrivePlc(), board=m.Board.STEER)
    line.step(50)
    assert line.texts(Kind.REFUSED) == [
        "ports swapped: the drive PLC answers where the steer PLC should be"
    ]
    assert line.link.state is LinkState.REFUSED
    sent = line.link.counters.sent
    assert not line.link.send_command(m.SteerCommand(1, 0, 0, 0, 0))
    line.step(50)
    assert line.link.counters.sent == sent
    line.step(500)
    assert not line.link.wants_reopen  # opening the port anew would reset a UNO
    assert len(line.texts(Kind.REFUSED)) == 1
    assert 2 * 5 <= len(line.sent_of(m.Hello)) <= 2 * 8  # it is asked again every second
    line.link.closed(line.link.problem)
    line.link.opened(line.now)
    assert line.link.problem.startswith("ports swapped")  # until somebody else answers


def test_a_board_that_answers_after_it_was_refused_comes_up_on_the_open_port():
    line = Line(SteerPlc(major=1))
    line.step(50)
    assert line.link.state is LinkState.REFUSED
    line.plc = SteerPlc()  # flashed meanwhile
    line.step(110)
    assert line.link.up


def test_another_major_version_is_refused_and_a_newer_minor_is_not():
    line = Line(SteerPlc(major=1))
    line.step(50)
    assert "speaks protocol version 1, this bridge 2: flash it" in line.link.problem
    assert line.link.state is LinkState.REFUSED
    line = Line(SteerPlc(minor=3))
    line.step(5)
    assert line.link.up
    assert line.texts(Kind.UP)[0].endswith("minor 0 is used")


def test_an_old_acknowledgement_does_not_bring_the_link_up():
    line = Line()
    line.step(0)
    ack = m.HelloAck(0, 1, 1, 0, 0, 1, 1, 0, 12345, 0, 200)
    line.to_host = lambda data: encode(ack, board=m.Board.STEER, seq=0, session=3)
    line.step(20)
    assert not line.link.up


@pytest.mark.parametrize("cause", ["boot event", "lost boot event"])
def test_a_reboot_is_seen_and_the_handshake_done_again(cause):
    line = Line()
    line.step(20)
    line.plc.reset()
    if cause == "lost boot event":
        line.to_host = lambda data: b""
        line.step(1)
        line.to_host = lambda data: data
    line.step(5)
    assert line.kinds() == [Kind.UP, Kind.REBOOTED, Kind.UP]
    assert line.link.identity.boot_count == 2


def test_a_reboot_that_only_the_clock_shows():
    line = Line()
    line.step(20)
    line.start_us += 1_500_000
    line.step(1)
    assert line.kinds()[-1] is Kind.REBOOTED


def test_the_wrap_of_the_clock_is_no_reboot():
    line = Line(start_us=(1 << 32) - 1_000_000)
    line.commanding = True
    line.step(300)
    assert line.kinds() == [Kind.UP]
    assert line.link.telemetry.t < 3_000_000
    assert line.plc.counters.stale == 0


def test_telemetry_ages_to_degraded_then_lost_then_greeted_on_the_open_port():
    line = Line()
    line.step(20)
    line.to_host = lambda data: b""
    line.step(15)
    assert 0.1 < line.link.telemetry_age(line.now) < 0.3
    assert line.link.up
    line.step(20)
    assert line.kinds() == [Kind.UP, Kind.LOST]
    assert not line.link.wants_reopen  # opening the port anew would reset a UNO
    assert line.link.down_reason.startswith("no telemetry for 0.3")
    line.to_host = lambda data: data
    line.step(25)
    assert line.link.up
    assert line.link.counters.losses == 1
    assert line.link.set_up


def test_a_port_is_opened_anew_after_three_handshakes_without_an_answer():
    line = Line()
    line.to_host = lambda data: b""
    line.step(890)
    assert not line.link.wants_reopen
    assert line.kinds() == [Kind.SILENT]  # told once
    line.step(20)
    assert line.link.wants_reopen


def test_requests_for_limits_and_counters_keep_100_ms_between_them():
    line = Line(DrivePlc(), board=m.Board.DRIVE)
    limits = iter([True] * 40)
    line.to_host = lambda data: b"" if 30 < len(data) < 75 and next(limits, False) else data
    line.step(3000)
    requests = [
        (t, type(q)) for t, q in line.sent if isinstance(q, m.LimitsRequest | m.StatsRequest)
    ]
    assert {kind for _, kind in requests} == {m.LimitsRequest, m.StatsRequest}
    gaps = [b[0] - a[0] for a, b in itertools.pairwise(requests)]
    assert min(gaps) > 0.099


# ---- set-up ----


@pytest.mark.parametrize("plc", [SteerPlc, DrivePlc])
def test_a_board_is_set_up_once_per_session_when_it_is_safe(plc):
    line = Line(plc(), board=plc.board)
    line.step(300)
    setups = line.sent_of(m.SteerSetup) + line.sent_of(m.DriveSetup)
    assert setups == [SETUPS[plc.board]]
    assert line.link.set_up
    assert line.link.telemetry.flags & m.StateFlag.SET_UP
    line.plc.reset()
    line.step(20)
    assert len(line.sent_of(m.SteerSetup) + line.sent_of(m.DriveSetup)) == 2
    assert line.link.set_up


def test_setup_waits_until_the_board_is_cleared():
    line = Line()
    line.measurement = SteerMeasurement(estop_pressed=True)
    line.step(100)
    assert line.sent_of(m.SteerSetup) == []
    assert line.link.limits is not None
    line.measurement = SteerMeasurement()
    line.step(2)
    assert line.control(m.Op.CLEAR) is m.Result.OK
    assert line.link.set_up


def test_setup_is_repeated_until_it_is_acknowledged():
    line = Line()
    line.step(1)
    losses = iter([True] * 7)
    line.to_plc = lambda data: b"" if next(losses, False) else data
    line.step(60)
    assert 2 <= len(line.sent_of(m.SteerSetup)) <= 3
    assert line.link.set_up


def test_a_board_that_never_acknowledges_its_setup_is_named_and_asked_again():
    line = Line()
    line.step(1)
    line.to_plc = lambda data: b""
    line.step(40)
    assert line.link.problem == "steer PLC did not acknowledge its set-up"
    assert line.texts(Kind.SETUP_FAILED) == [line.link.problem]
    assert len(line.sent_of(m.SteerSetup)) == 4
    line.to_plc = lambda data: data
    line.step(100)
    assert line.link.set_up
    assert line.link.problem is None


def test_a_setup_out_of_range_says_which_limit_the_board_has():
    line = Line(DrivePlc(), board=m.Board.DRIVE)
    line.link.setup = dataclasses.replace(SETUPS[m.Board.DRIVE], max_speed=5000, torque=4000)
    line.step(300)
    assert line.link.problem == (
        "drive PLC refused its set-up: out of range: "
        "max_speed 5.000 m/s, the board allows 4.800 m/s, "
        "torque 40.00 N m, the board allows 35.00 N m"
    )
    assert line.texts(Kind.SETUP_FAILED) == [line.link.problem]
    assert len(line.sent_of(m.DriveSetup)) == 1
    assert not line.link.set_up


# ---- operations ----


def test_ctrl_has_the_number_of_the_operation_and_the_echo_of_the_newest_telemetry():
    line = Line()
    line.step(20)
    losses = iter([True] * 8)
    line.to_plc = lambda data: b"" if next(losses, False) else data
    line.control(m.Op.CLEAR)
    line.control(m.Op.DISARM)
    controls = [(t, q) for t, q in line.sent if isinstance(q, m.Control)]
    numbers = [q.number for _, q in controls]
    assert len(numbers) > 2
    assert sorted(set(numbers)) == [numbers[0], numbers[0] + 1]
    echoes = [q.echo * m.ECHO_TICK for _, q in controls]
    assert echoes == pytest.approx([t - 100.0 for t, _ in controls], abs=0.015)


def test_ctrl_is_resent_until_it_is_answered():
    line = Line()
    line.commanding = True
    line.step(20)
    losses = iter([True] * 8)
    line.to_plc = lambda data: b"" if next(losses, False) else data
    assert line.control(m.Op.ARM) is m.Result.OK
    assert line.plc.state is m.PlcState.ARMED


def test_ctrl_that_nobody_answers_is_given_up_after_three_resends():
    line = Line()
    line.step(20)
    sent = []
    line.to_plc = lambda data: (sent.append(data), b"")[1]
    assert line.control(m.Op.CLEAR) is None
    decoder = FrameDecoder(m.Board.STEER, host=False)
    decoder.session = line.link.decoder.session
    frames = [f for data in sent for f in decoder.feed(data)]
    controls = [
        f for f in frames if isinstance(f.message, m.Control) and f.message.op == m.Op.CLEAR
    ]
    assert len({f.seq for f in controls}) == len(controls) == 4


def test_estop_overtakes_what_waits():
    line = Line()
    line.step(20)
    line.to_plc = lambda data: b""
    line.link.operate(m.Op.CLEAR, line.now)
    line.link.operate(m.Op.ARM, line.now)
    line.step(1)
    line.to_plc = lambda data: data
    assert line.control(m.Op.ESTOP) is m.Result.OK
    assert line.plc.state is m.PlcState.ESTOP
    assert [e.operation.op for e in line.events if e.operation] == [m.Op.ESTOP]


def test_a_command_carries_the_echo_of_the_newest_telemetry():
    line = Line()
    line.commanding = True
    line.step(100)
    line.to_host = lambda data: b""  # the PLC no longer gets through to us ...
    line.step(25)
    assert line.plc.counters.stale > 5  # ... and so does not obey us


def test_a_command_for_the_other_board_is_a_mistake():
    line = Line()
    with pytest.raises(m.LinkError, match="DriveCommand sent to the steer PLC"):
        line.link.send_command(m.DriveCommand(0, 0, 0, 0, 0, 0, 0))


def test_lost_and_repeated_frames_are_counted():
    line = Line()
    line.step(180)  # between two PING
    kept = iter([b""] * 3)
    line.to_host = lambda data: next(kept, data)
    line.step(4)
    assert line.link.counters.seq_gaps == 3
    line.to_host = lambda data: data + data
    line.step(1)
    assert line.link.counters.duplicates == 1


@pytest.mark.slow
@pytest.mark.parametrize("plc", [SteerPlc, DrivePlc])
def test_one_damaged_frame_in_a_hundred_leaves_no_count_open(plc):
    rng = random.Random(3)
    line = Line(plc(), board=plc.board)
    line.commanding = True
    line.step(10)
    damaged = {"to_plc": 0, "to_host": 0}

    def noisy(direction):
        def damage(data):
            frames = data.split(b"\0")[:-1]
            for i, frame in enumerate(frames):
                if rng.random() < 0.01:
                    damaged[direction] += 1
                    k = rng.randrange(len(frame))
                    flipped = frame[k] ^ (1 << rng.randrange(8)) or 1
                    frames[i] = frame[:k] + bytes([flipped]) + frame[k + 1 :]
            return b"".join(f + b"\0" for f in frames)

        return damage

    line.to_plc, line.to_host = noisy("to_plc"), noisy("to_host")
    line.step(5000)
    line.to_plc = line.to_host = lambda data: data
    line.step(101)  # the next STATS
    counters, stats = line.link.decoder.counters, line.link.stats
    unchanged = 2  # a flip to 0 that is turned into 1 may be the byte itself
    assert abs(counters.rejected - damaged["to_host"]) <= unchanged
    assert line.link.counters.seq_gaps == counters.rejected
    rejected = stats.crc + stats.cobs + stats.length + stats.unknown + stats.version + stats.session
    assert abs(rejected - damaged["to_plc"]) <= unchanged
    assert stats.seq_gap == rejected
    assert stats.stale == 0
