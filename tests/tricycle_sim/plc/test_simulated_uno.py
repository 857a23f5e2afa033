"""The real firmware on two simulated UNOs, driven by the real bridge, in lockstep."""

import random

import pytest

from tricycle_bridge.bridge import Bridge
from tricycle_bridge.command_stream import Source, VehicleCommand
from tricycle_bridge.protocol.messages import Board, Fault, PlcState
from tricycle_bridge.settings import BridgeSettings
from tricycle_core.errors import LinkError
from tricycle_sim.plc.simulated_uno import DrivePins, SimulatedUno

STEER, DRIVE = Board.STEER, Board.DRIVE
MASS_AT_TREAD = 48.3 * 0.335  # N s^2: torque over this is acceleration


class Loop:
    """Bridge, two UNOs, a servo that follows and a mass that the motor pushes; 1 ms slices."""

    def __init__(self, build):
        self.bridge = Bridge(BridgeSettings(max_acceleration=1.0), rng=random.Random(0))
        self.bridge.active = True
        self.unos = {STEER: SimulatedUno(build, "steer"), DRIVE: SimulatedUno(build, "drive")}
        self.ms = 0
        self.angle = self.speed = 0.0
        self.target = (0.0, 0.0)
        self.outcomes = []
        self.events = []
        for board in self.unos:
            self.bridge.opened(board, self.now)

    @property
    def now(self):
        return 100.0 + self.ms * 1e-3

    def run(self, seconds):
        for _ in range(round(seconds * 1000)):
            self.ms += 1
            self._move()
            for board, uno in self.unos.items():
                uno.run(self.ms * 1000)
                self.bridge.receive(board, uno.read(), self.now)
            self.bridge.poll(self.now)
            if self.target is not None and self.ms % 10 == 0:
                setpoint = VehicleCommand(*self.target)
                self.bridge.set_command(
                    setpoint, stamp=self.now, now=self.now, source=Source.JOINT_COMMANDS
                )
            for board, frames in self.bridge.take_frames().items():
                self.unos[board].write(b"".join(frames))

    def _move(self):
        steer, drive = self.unos[STEER].steer_pins(), self.unos[DRIVE].drive_pins()
        if steer.servo_on:
            self.angle += min(max(steer.angle - self.angle, -4e-3), 4e-3)
        self.speed += 1e-3 * drive.torque / MASS_AT_TREAD
        braked = 1e-3 * 25.0 * drive.brake / MASS_AT_TREAD
        self.speed = max(self.speed - braked, min(self.speed + braked, 0.0))
        self.unos[STEER].steering_angle(self.angle)
        self.unos[DRIVE].wheel_speed(self.speed)

    def telemetry(self, board):
        return self.bridge.links[board].telemetry

    def states(self):
        return [PlcState(self.telemetry(board).state) for board in self.unos]

    def arm(self):
        self.bridge.arm(self.now, self.outcomes.append)
        self.run(0.5)
        return self.outcomes[-1]


@pytest.fixture
def loop(firmware_images):
    loop = Loop(firmware_images)
    loop.run(0.3)
    yield loop
    for uno in loop.unos.values():
        uno.close()


@pytest.fixture
def driving(loop):
    assert loop.arm() == (True, "armed")
    loop.target = (0.3, 1.0)
    loop.run(4.5)
    return loop


@pytest.mark.slow
def test_the_firmware_drives(driving):
    assert driving.states() == [PlcState.ARMED] * 2
    assert driving.angle == pytest.approx(0.3, abs=2e-3)
    assert driving.telemetry(STEER).angle == pytest.approx(3000, abs=25)  # a count is 23
    assert driving.speed == pytest.approx(1.0, abs=0.03)
    assert driving.telemetry(DRIVE).speed == pytest.approx(1000, abs=30)
    assert driving.telemetry(DRIVE).supply == pytest.approx(48000, abs=100)
    for link in driving.bridge.links.values():
        assert link.decoder.counters.rejected == 0
        assert link.stats.max_tick < 10_000
        assert (link.stats.tick_overrun, link.stats.rx_overrun, link.stats.stale) == (0, 0, 0)


@pytest.mark.slow
def test_silence_stops_the_firmware(driving):
    driving.target = None
    driving.run(2.5)
    assert driving.states() == [PlcState.SAFE] * 2
    assert driving.speed == pytest.approx(0.0, abs=1e-3)
    for board in (STEER, DRIVE):
        assert driving.telemetry(board).faults == Fault.CMD_TIMEOUT
    assert not driving.unos[STEER].steer_pins().servo_on
    assert driving.unos[DRIVE].drive_pins() == DrivePins(0.0, 1.0)
    driving.target = (0.0, 0.0)
    driving.run(0.2)
    assert driving.arm() == (True, "armed")


@pytest.mark.slow
def test_the_estop_pin_cuts_the_outputs_within_two_ticks(driving):
    driving.unos[DRIVE].estop(pressed=True)
    driving.run(0.02)
    assert driving.unos[DRIVE].drive_pins() == DrivePins(0.0, 1.0)
    driving.run(2.0)
    assert driving.states() == [PlcState.SAFE, PlcState.ESTOP]
    assert driving.telemetry(DRIVE).faults == Fault.ESTOP_HW


@pytest.mark.slow
def test_a_reset_button_in_mid_drive_needs_the_operator(driving):
    assert driving.bridge.links[STEER].identity.boot_count == 1
    driving.unos[STEER].reset()
    driving.run(2.5)
    assert driving.states() == [PlcState.SAFE] * 2
    assert driving.bridge.links[STEER].identity.boot_count == 2  # kept in EEPROM
    driving.target = (0.0, 0.0)
    driving.run(0.2)
    assert driving.arm() == (True, "armed")


def test_a_build_that_is_missing_is_named(tmp_path):
    with pytest.raises(LinkError, match=r"steer.elf does not exist: `make firmware`"):
        SimulatedUno(tmp_path, "drive")
