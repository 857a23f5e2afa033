"""The host's side of one link against the emulated PLC, on a simulated clock."""

import random

import pytest

from tricycle_bridge.link import LinkEventKind, LinkState, PlcLink
from tricycle_bridge.protocol import messages as m
from tricycle_bridge.protocol.framing import FrameDecoder, encode
from tricycle_sim.plc import DriveMeasurement, DrivePlc, SteerMeasurement, SteerPlc

Kind = LinkEventKind


class Line:
    """A link and a PLC with a simulated clock and a cable that can be cut or noisy."""

    def __init__(self, plc=None, *, board=m.Board.STEER, boot_wait=0.0, start_us=0):
        self.plc = plc or SteerPlc()
        self.link = PlcLink(board, rng=random.Random(1), boot_wait=boot_wait)
        self.now = 100.0
        self.start_us = start_us
        self.events = []
        self.to_plc = lambda data: data
        self.to_host = lambda data: data
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
            answer = self.plc.receive(self.to_plc(b"".join(self.link.take_frames())), self.now_us)
            telemetry, _ = self.plc.tick(self.now_us, self.measurement)
            self.events += self.link.receive(self.to_host(answer + telemetry), self.now)

    def control(self, op):
        self.link.operate(op, self.now)
        self.step(30)
        return [e.operation.result for e in self.events if e.operation][-1]


def test_the_link_is_up_within_a_tick_of_the_first_hello():
    line = Line()
    line.step(2)
    assert line.kinds() == [Kind.UP]
    assert line.texts(Kind.UP) == ["steer PLC: firmware 1.0.0, boot 1, last reset: power-on"]
    line.step(10)
    assert line.link.limits.max_angle == 7854
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
    assert not line.link.wants_reopen(line.now)
    line.step(100)
    assert line.link.wants_reopen(line.now)
    line.link.closed(line.link.problem)
    line.link.opened(line.now)
    assert line.link.problem.startswith("ports swapped")  # until somebody else answers


def test_another_major_version_is_refused_and_a_newer_minor_is_not():
    line = Line(SteerPlc(major=2))
    line.step(50)
    assert "speaks protocol version 2" in line.link.problem
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


def test_telemetry_ages_to_degraded_then_lost_then_reopen():
    line = Line()
    line.step(20)
    line.to_host = lambda data: b""
    line.step(15)
    assert 0.1 < line.link.telemetry_age(line.now) < 0.3
    assert line.link.up
    line.step(20)
    assert line.kinds() == [Kind.UP, Kind.LOST]
    assert line.link.wants_reopen(line.now)
    line.link.closed("reopened")
    line.link.opened(line.now)
    line.to_host = lambda data: data
    line.step(5)
    assert line.link.up
    assert line.link.counters.losses == 1


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
    controls = [f for f in frames if f.message == m.Control.of(m.Op.CLEAR)]
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
    line.step(20)
    kept = iter([b""] * 3)
    line.to_host = lambda data: next(kept, data)
    line.step(4)
    assert line.link.counters.seq_gaps == 3
    line.to_host = lambda data: data + data
    line.step(1)
    assert line.link.counters.duplicates == 1


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
