"""The vehicle driven by the real firmware: it does what the emulated PLCs do, within a wheel."""

import random
import shutil

import numpy as np
import pytest

from tricycle_bridge.bridge import Bridge
from tricycle_bridge.commands.command_stream import Source, VehicleCommand
from tricycle_bridge.protocol.messages import Board, Fault, PlcState
from tricycle_bridge.settings import BridgeSettings
from tricycle_core.errors import LinkError
from tricycle_sim.rig.emulated import EmulatedRig
from tricycle_sim.rig.firmware import FirmwareRig
from tricycle_sim.rig.host import Host
from tricycle_sim.vehicle import load_vehicle

STEER, DRIVE = Board.STEER, Board.DRIVE
VEHICLE = load_vehicle()


class Drive:
    """A bridge that answers every tick of a rig."""

    def __init__(self, rig):
        self.rig = rig
        self.bridge = Bridge(BridgeSettings(), rng=random.Random(0))
        self.bridge.active = True
        self.target = (0.0, 0.0)
        self.said = []
        for board in (STEER, DRIVE):
            self.bridge.opened(board, self.now)

    @property
    def now(self):
        return 100.0 + self.rig.time

    def tick(self):
        bridge, now = self.bridge, self.now
        if self.target is not None:
            setpoint = VehicleCommand(*self.target)
            bridge.set_command(setpoint, stamp=now, now=now, source=Source.JOINT_COMMANDS)
        bridge.poll(now)
        for board, frames in bridge.take_frames().items():
            bridge.receive(board, self.rig.receive(board, b"".join(frames)), now)
        for board, data in self.rig.step().items():
            bridge.receive(board, data, self.now)
        self.said += bridge.take_log()

    def run(self, seconds):
        for _ in range(round(100 * seconds)):
            self.tick()

    def arm(self):
        outcomes = []
        self.run(0.3)
        self.bridge.arm(self.now, outcomes.append)
        self.run(0.5)
        assert outcomes == [(True, "armed")]
        assert self.rig.armed

    def states(self):
        return [PlcState(link.telemetry.state) for link in self.bridge.links.values()]


def test_a_board_stays_where_no_other_boots(firmware_images, tmp_path):
    build = shutil.copytree(firmware_images, tmp_path / "build")
    with FirmwareRig(VEHICLE, build) as rig:
        drive = Drive(rig)
        drive.arm()
        image = build / "drive.elf"
        for content, said in (
            (None, "drive.elf does not exist"),
            (b"", "drive.elf: is not a firmware image: `make firmware` builds it"),
            (image.read_bytes()[:1000], "the firmware crashed"),
        ):
            image.unlink()
            if content is not None:
                image.write_bytes(content)
            with pytest.raises(LinkError, match=said):
                rig._boards[DRIVE].replace()
            drive.run(0.1)
            assert drive.states() == [PlcState.ARMED, PlcState.ARMED]
            image.touch()


@pytest.fixture
def rig(firmware_images):
    rig = FirmwareRig(VEHICLE, firmware_images)
    yield rig
    rig.close()


def slalom(drive, seconds):
    """Positions (n, 2), steering angles (n,) and wheel travel (n,) under the same commands."""
    drive.arm()
    rows = []
    for tick in range(round(100 * seconds)):
        t = 0.01 * tick
        drive.target = (0.3 * np.sin(t) * (t > 3.0), min(t, 1.2))
        drive.tick()
        state = drive.rig.state
        rows.append((state.x, state.y, state.steering_motor_angle, state.drive_angle * 0.335))
    return np.split(np.array(rows), [2, 3], axis=1)


@pytest.mark.slow
def test_the_firmware_drives_what_the_emulation_drives(rig):
    for _ in range(7):
        rig.step()
    rig.reset()  # which leaves the boards' ticks where they were between ours
    drive = Drive(rig)
    position, angle, travel = slalom(drive, 9.0)
    emulated_position, emulated_angle, emulated_travel = slalom(Drive(EmulatedRig(VEHICLE)), 9.0)
    # set-points on the wire are 0.1 mrad, a step of the servo's pulse likewise
    assert np.abs(angle - emulated_angle).max() < 2e-4
    # from rest on the wheel is unseen for up to a hall pulse of 15 mm
    assert np.abs(travel - emulated_travel).max() < 0.03
    assert np.linalg.norm(position - emulated_position, axis=1).max() < 0.04
    for link in drive.bridge.links.values():
        assert (link.decoder.counters.rejected, link.counters.seq_gaps) == (0, 0)
        assert (link.stats.stale, link.stats.crc, link.stats.seq_gap) == (0, 0, 0)
        assert (link.stats.rx_overrun, link.stats.tick_overrun) == (0, 0)
        assert link.stats.max_tick < 5_000  # us, half of a tick


def test_the_host_has_answered_when_both_boards_were_sent_a_command(rig):
    drive = Drive(rig)
    drive.arm()
    assert not rig.answered
    drive.bridge.set_command(
        VehicleCommand(0.0, 0.0), stamp=drive.now, now=drive.now, source=Source.JOINT_COMMANDS
    )
    frames = drive.bridge.take_frames()
    rig.receive(STEER, b"".join(frames[STEER]))
    assert rig.heard(STEER)
    assert not rig.answered
    rig.receive(DRIVE, b"".join(frames[DRIVE]))
    assert rig.answered
    rig.step()
    assert not rig.answered


def test_readings_are_stamped_with_the_time_of_what_the_boards_were_shown(rig):
    host = Host(rig)
    host.arm()
    shown, read = [], []
    for tick in range(400):
        angle = 0.3 * np.sin(0.05 * tick)
        host.target = VehicleCommand(angle, 0.0)
        shown.append((host.now, rig.state.steering_motor_angle))
        host.tick()
        for stamp, (steering, _) in host.readings:
            read.append((stamp, steering.position))
    times, angles = np.array(shown).T
    stamps, positions = np.array(read).T

    def deviation(late):
        return np.std(positions - np.interp(stamps - late, times, angles))

    late = np.arange(-10.0, 10.0, 0.25) * 1e-3
    assert abs(late[np.argmin([deviation(each) for each in late])]) < 1e-3


@pytest.mark.slow
def test_a_silent_host_stops_the_vehicle(rig):
    drive = Drive(rig)
    drive.arm()
    drive.target = (0.0, 1.0)
    drive.run(2.5)
    assert rig.state.vx > 0.9
    drive.target = None
    drive.run(4.0)
    assert drive.states() == [PlcState.SAFE] * 2
    assert drive.bridge.links[DRIVE].telemetry.faults == Fault.CMD_TIMEOUT
    assert abs(rig.state.vx) < 0.01


@pytest.mark.slow
def test_reset_puts_fresh_boards_in_and_time_goes_on(rig):
    drive = Drive(rig)
    drive.arm()
    drive.target = (0.2, 1.0)
    drive.run(2.0)
    before = rig.time
    rig.reset()
    assert rig.time == before
    assert not rig.armed
    assert (rig.state.x, rig.state.vx) == pytest.approx((0.0, 0.0), abs=1e-3)
    drive.target = (0.0, 0.0)
    drive.run(1.0)
    assert drive.states() == [PlcState.SAFE] * 2
    assert any("rebooted" in text for _, text in drive.said)
    drive.arm()  # by the operator, not by itself


def test_images_that_are_missing_are_named(tmp_path):
    with pytest.raises(LinkError, match=r"steer.elf does not exist: `make firmware`"):
        FirmwareRig(VEHICLE, tmp_path)
