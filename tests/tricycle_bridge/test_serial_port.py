"""Real serial I/O on ptys: faults of cables and devices."""

import os
import random
import threading
import time

import pytest

from tricycle_bridge.bridge import Bridge
from tricycle_bridge.commands.command_stream import Source, VehicleCommand
from tricycle_bridge.protocol.messages import Board, Fault, PlcState
from tricycle_bridge.serial_port import Closed, Opened, Received, SerialPorts
from tricycle_bridge.settings import BridgeSettings
from tricycle_sim.plc.pair import PlcPair
from tricycle_sim.plc.pty_port import PtyPort

STEER, DRIVE = Board.STEER, Board.DRIVE
PATIENCE = 20.0  # s; only a failing test waits that long
REPLUGS = int(os.environ.get("REPLUGS", "10"))  # `make soak`: 100
# why arming is refused after a pause; the last two by a PLC whose newest command is older than
# 200 ms, or which got CLEAR four times within 200 ms with an echo older than 150 ms
PAUSES = (
    "no command stream",
    "no telemetry for",
    "CMD_TIMEOUT",
    "refused ARM: preconditions",
    "refused CLEAR: stale",
)


class Host:
    """What the bridge node does, without ROS: ports, bridge and a commander on the wall clock."""

    def __init__(self, steer_path, drive_path):
        self.ready = threading.Event()
        self.ports = SerialPorts({STEER: steer_path, DRIVE: drive_path}, self.ready.set)
        self.bridge = Bridge(BridgeSettings(), rng=random.Random(0))
        self.bridge.active = True
        self.target = (0.0, 0.0)
        self.closed = []

    def spin_once(self):
        self.ready.wait(0.005)
        self.ready.clear()
        now = time.monotonic()
        for event in self.ports.take_events():
            match event:
                case Received():
                    self.bridge.receive(event.board, event.data, now)
                case Opened():
                    self.bridge.opened(event.board, now)
                case Closed():
                    self.closed.append(event)
                    self.bridge.closed(event.board, event.reason)
        self.bridge.poll(now)
        if self.target is not None:
            command = VehicleCommand(*self.target)
            self.bridge.set_command(command, stamp=now, now=now, source=Source.JOINT_COMMANDS)
        for board, frames in self.bridge.take_frames().items():
            link = self.bridge.links[board]
            link.counters.write_drops += self.ports.write(board, frames)
            if link.wants_reopen:
                self.ports.reopen(board, link.problem)

    def until(self, condition, what):
        start = time.monotonic()
        while not condition():
            assert time.monotonic() - start < PATIENCE, f"waited in vain for {what}"
            self.spin_once()
        return time.monotonic() - start

    def up(self):
        return all(link.up and link.telemetry for link in self.bridge.links.values())

    def arm(self):
        """Arm at standstill; again where the machine held this commander up for 100 ms or more."""
        self.target = (0.0, 0.0)
        deadline = time.monotonic() + PATIENCE
        answers = [(False, PAUSES[0])]
        while not self.bridge.armed:
            success, text = answers.pop()
            assert success or any(pause in text for pause in PAUSES), text
            assert time.monotonic() < deadline, text
            self.until(lambda: not self.bridge.refusal(time.monotonic()), "a reason to be gone")
            self.bridge.arm(time.monotonic(), answers.append)
            self.until(lambda: answers, "an answer")

    def drive(self, angle, speed, pair):
        """Arm and drive at a speed; again where this commander paused until the boards stopped."""
        while pair.speed < speed - 0.1:
            self.arm()
            self.target = (angle, speed)
            self.until(
                lambda: pair.speed > speed - 0.1 or pair.drive.state is PlcState.SAFE, "speed"
            )
            if pair.speed < speed - 0.1:
                assert (pair.steer.faults | pair.drive.faults) & Fault.CMD_TIMEOUT


@pytest.fixture
def host(plc_pair):
    host = Host(plc_pair.steer_path, plc_pair.drive_path)
    yield host
    host.ports.close()


@pytest.fixture
def line(tmp_path):
    """A board's end of a serial line, and the ports that are open at the other."""
    with PtyPort(tmp_path / "plc") as board:
        opened = threading.Event()
        ports = SerialPorts({STEER: str(board.path)}, opened.set)
        assert opened.wait(PATIENCE)
        yield board, ports
        ports.close()


def _replug(host, pair, board, rng):
    """Unplug for up to 20 ms; returns the time from the device's return to the link's (s)."""
    link = host.bridge.links[board]
    before = link.identity
    pair.unplug(board)
    off = time.monotonic() + 0.02 * rng.random()
    while time.monotonic() < off:
        host.spin_once()
    pair.plug(board)
    return host.until(
        lambda: link.up and link.identity is not before and link.telemetry, "the link"
    )


@pytest.mark.slow
def test_unplugged_and_replugged_at_random_moments_it_comes_back_unarmed(host, plc_pair):
    rng = random.Random(0)
    host.until(host.up, "both links")
    for _ in range(5):
        host.arm()
        board = rng.choice((STEER, DRIVE))
        _replug(host, plc_pair, board, rng)
        assert not host.bridge.armed
        assert plc_pair.plc(board).state is PlcState.SAFE


@pytest.mark.slow
def test_after_replugs_in_mid_drive_each_board_is_back_within_half_a_second(host, plc_pair):
    rng = random.Random(1)
    times = []
    for _ in range(REPLUGS):
        host.arm()
        host.target = (0.1, 0.3)
        until = time.monotonic() + 0.2 * rng.random()
        while time.monotonic() < until:
            host.spin_once()
        board = rng.choice((STEER, DRIVE))
        times.append(_replug(host, plc_pair, board, rng))
        assert not host.bridge.armed
        host.target = (0.0, 0.0)
        other = plc_pair.drive if board is STEER else plc_pair.steer
        host.until(lambda plc=other: plc.state is PlcState.SAFE, "the other board")
    stalls = 1 + REPLUGS // 100  # the machine's, now and then
    assert sorted(times)[-1 - stalls] < 0.5, sorted(times)[-9:]


@pytest.mark.slow
def test_a_stalled_board_gets_no_stale_command(host, plc_pair):
    host.drive(0.2, 0.5, plc_pair)
    plc_pair.stall(STEER)
    frozen = plc_pair.steering_angle
    host.target = (-0.5, 0.0)  # is sent while the link is still up
    host.until(lambda: plc_pair.drive.state is PlcState.SAFE, "the drive to stop")
    until = time.monotonic() + 0.5
    while time.monotonic() < until:
        host.spin_once()
    plc_pair.stall(STEER, stalled=False)
    host.until(host.up, "both links")
    assert plc_pair.steer.faults & Fault.CMD_TIMEOUT or plc_pair.steer.state is PlcState.SAFE
    assert plc_pair.steering_angle == frozen


@pytest.mark.slow
def test_garbage_at_full_line_rate_hurts_nobody(host, plc_pair):
    rng = random.Random(2)
    host.arm()
    host.target = (0.1, 0.5)
    for _ in range(300):
        plc_pair.ports[STEER].write(rng.randbytes(115) + b"\0")
        host.spin_once()
    host.until(lambda: plc_pair.speed > 0.4, "speed")
    assert host.bridge.links[STEER].up
    assert host.bridge.links[STEER].decoder.counters.rejected > 100


def test_missing_devices_are_told_once_each_and_opened_when_they_appear(tmp_path):
    host = Host(str(tmp_path / "steer"), str(tmp_path / "drive"))
    try:
        host.until(lambda: len(host.closed) >= 4, "retries")
        assert {e.reason for e in host.closed} == {
            f"{tmp_path}/steer does not exist",
            f"{tmp_path}/drive does not exist",
        }
        assert len(host.bridge.take_log()) == 2
        with PlcPair(tmp_path / "steer", tmp_path / "drive"):
            host.until(host.up, "both links")
    finally:
        host.ports.close()


def test_a_file_or_folder_in_place_of_a_device_is_told(tmp_path):
    (tmp_path / "steer").write_text("no board")
    (tmp_path / "drive").mkdir()
    host = Host(str(tmp_path / "steer"), str(tmp_path / "drive"))
    try:
        host.until(lambda: len(host.closed) >= 2, "both")
        assert {e.reason for e in host.closed} == {
            f"{tmp_path}/steer is no serial port",
            f"{tmp_path}/drive is no serial port",
        }
    finally:
        host.ports.close()


@pytest.mark.slow
def test_swapped_cables_in_operation_are_named(host, plc_pair):
    host.arm()
    plc_pair.swap()
    host.until(
        lambda: all("ports swapped" in link.down_reason for link in host.bridge.links.values()),
        "the diagnosis",
    )
    assert not host.bridge.armed
    plc_pair.swap()
    host.until(host.up, "both links")


def test_a_device_in_use_is_said_to_be(tmp_path, plc_pair):
    first = SerialPorts({STEER: plc_pair.steer_path}, lambda: None)
    events = []
    while not any(isinstance(e, Opened) for e in events):
        events += first.take_events()
    second = SerialPorts({STEER: plc_pair.steer_path}, lambda: None)
    events = []
    while not events:
        events += second.take_events()
    assert events[0] == Closed(STEER, f"{plc_pair.steer_path} is in use by another program")
    first.close()
    second.close()


def test_what_has_arrived_is_taken_while_the_io_thread_is_busy(tmp_path):
    """A command echoes the newest telemetry; with an old echo the PLC refuses it."""
    called, free = threading.Event(), threading.Event()

    def notify():
        called.set()
        assert free.wait(PATIENCE)

    with PtyPort(tmp_path / "steer") as board:
        ports = SerialPorts({STEER: str(board.path)}, notify)
        assert called.wait(PATIENCE)  # of the opening; the I/O thread hangs from here on
        assert ports.take_events() == [Opened(STEER)]
        for data in (b"first", b"second"):
            assert board.write(data)
            taken = b""
            deadline = time.monotonic() + PATIENCE
            while taken != data:  # the kernel passes it on when it likes
                assert time.monotonic() < deadline, taken
                taken += b"".join(event.data for event in ports.take_events())
        free.set()
        ports.close()


@pytest.mark.slow
def test_what_nobody_takes_costs_no_memory(line):
    board, ports = line
    sent = 0
    deadline = time.monotonic() + PATIENCE
    while sent < 1000:  # the I/O thread reads on, else the line would be full after some KiB
        assert time.monotonic() < deadline, f"the line took {sent} KiB"
        sent += board.write(bytes(1024))
    waiting = [event for event in ports.take_events() if isinstance(event, Received)]
    assert 65536 < sum(len(event.data) for event in waiting) < 65536 + 2 * 4096


def test_a_frame_that_was_cut_ends_before_the_next(line, monkeypatch):
    board, ports = line
    with monkeypatch.context() as patched:
        write = os.write
        patched.setattr(os, "write", lambda fd, data: write(fd, data[:3]))
        assert ports.write(STEER, [b"first\0"]) == 1
    assert ports.write(STEER, [b"next\0", b"last\0"]) == 0
    taken, deadline = b"", time.monotonic() + PATIENCE
    while taken != b"fir\0next\0last\0":
        assert time.monotonic() < deadline, taken
        taken += board.read()


def test_a_write_that_would_block_is_dropped_and_counted(line):
    _, ports = line
    dropped = 0
    for _ in range(5000):
        dropped += ports.write(STEER, [bytes(20)])
    assert 0 < dropped < 5000
    assert ports.write(DRIVE, [b"x", b"y"]) == 2  # no such port


def test_the_owner_is_called_also_while_nothing_arrives(tmp_path):
    """It acts on what is missing: a link that is lost, a command to repeat."""
    calls = threading.Semaphore(0)
    with PtyPort(tmp_path / "steer") as board:
        ports = SerialPorts({STEER: str(board.path)}, calls.release)
        try:
            for _ in range(5):
                assert calls.acquire(timeout=PATIENCE)
        finally:
            ports.close()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_an_exception_of_the_owner_ends_the_io_thread_which_the_owner_is_told(tmp_path):
    def notify():
        raise ValueError("a fault of the owner")

    ended = threading.Event()
    ports = SerialPorts({STEER: str(tmp_path / "steer")}, notify, ended=ended.set)
    assert ended.wait(PATIENCE)
    ports.close()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_after_the_io_thread_died_a_last_frame_can_be_sent_and_closing_frees_the_device(tmp_path):
    def notify():
        raise ValueError("a fault of the owner")

    ended = threading.Event()
    with PtyPort(tmp_path / "steer") as board:
        ports = SerialPorts({STEER: str(board.path)}, notify, ended=ended.set)
        assert ended.wait(PATIENCE)
        assert ports.write(STEER, [b"stop\0"]) == 0
        ports.close()
        assert ports.write(STEER, [b"more\0"]) == 1
        again = SerialPorts({STEER: str(board.path)}, lambda: None)
        events, deadline = [], time.monotonic() + PATIENCE
        while not events:
            assert time.monotonic() < deadline
            events = again.take_events()
        again.close()
    assert events == [Opened(STEER)]


def test_closing_is_no_end_that_the_owner_is_told(tmp_path):
    ended = threading.Event()
    ports = SerialPorts({STEER: str(tmp_path / "steer")}, lambda: None, ended=ended.set)
    ports.close()
    assert not ended.is_set()
