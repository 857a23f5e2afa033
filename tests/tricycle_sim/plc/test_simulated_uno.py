"""The real firmware on two simulated UNOs, driven by the real bridge, in lockstep."""

import random
import subprocess
from pathlib import Path

import pytest

from tricycle_bridge.bridge import Bridge
from tricycle_bridge.commands.command_stream import Source, VehicleCommand
from tricycle_bridge.protocol.framing import FrameDecoder, encode
from tricycle_bridge.protocol.messages import (
    Board,
    Event,
    EventCode,
    Fault,
    Hello,
    HelloAck,
    PlcState,
    ResetCause,
)
from tricycle_bridge.settings import BridgeSettings
from tricycle_core.errors import LinkError
from tricycle_sim.plc.simulated_uno import DrivePins, SimulatedUno

STEER, DRIVE = Board.STEER, Board.DRIVE
FIRMWARE = Path(__file__).parents[3] / "firmware"
# of the Arduino core for the UNO: its platform.txt
CORE_FLAGS = [
    "-c",
    "-g",
    "-Os",
    "-w",
    "-ffunction-sections",
    "-fdata-sections",
    "-flto",
    "-mmcu=atmega328p",
    "-DF_CPU=16000000L",
    "-DARDUINO=10819",
    "-DARDUINO_AVR_UNO",
    "-DARDUINO_ARCH_AVR",
]
C_FLAGS = ["-std=gnu11", "-fno-fat-lto-objects"]
CPP_FLAGS = ["-std=gnu++11", "-fpermissive", "-fno-exceptions", "-fno-threadsafe-statics"]
LINK_FLAGS = [
    "-w",
    "-Os",
    "-g",
    "-flto",
    "-fuse-linker-plugin",
    "-Wl,--gc-sections",
    "-mmcu=atmega328p",
]
# what the core's archive has that could get in the way
CORE = """
#include <avr/interrupt.h>
extern "C" { void setup(); void loop(); }
int main() { setup(); for (;;) loop(); }
ISR(USART_RX_vect) {}
"""
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
        assert link.stats.max_tick < 3_000
        assert (link.stats.tick_overrun, link.stats.rx_overrun, link.stats.stale) == (0, 0, 0)


@pytest.mark.slow
def test_the_alive_output_toggles_with_every_tick_of_a_driving_board(driving):
    for board, uno in driving.unos.items():
        levels = []
        for _ in range(40):
            driving.run(0.001)
            levels.append(uno.alive)
        edges = [k for k in range(1, 40) if levels[k] != levels[k - 1]]
        assert edges == list(range(edges[0], 40, 10)), board
    driving.unos[DRIVE].estop(pressed=True)
    driving.run(0.02)
    assert not driving.unos[DRIVE].alive


@pytest.mark.slow
def test_a_board_that_hangs_lets_go_before_it_resets(driving):
    uno = driving.unos[DRIVE]
    uno.hang()
    driving.run(0.045)
    assert (uno.drive_pins(), uno.alive) == (DrivePins(0.0, 1.0), False)
    driving.run(0.1)
    assert uno.drive_pins() == DrivePins(0.0, 1.0)
    assert driving.states()[1] == PlcState.SAFE
    assert driving.telemetry(DRIVE).faults & Fault.WDT_RESET


class Line:
    """One UNO and what it says."""

    def __init__(self, uno):
        self.uno = uno
        self.us = 0
        self.decoder = FrameDecoder(DRIVE, host=True)

    def run(self, seconds):
        """Messages of that time."""
        self.us += round(seconds * 1e6)
        self.uno.run(self.us)
        return [frame.message for frame in self.decoder.feed(self.uno.read())]

    def reset_cause(self):
        """It answers a HELLO."""
        self.decoder.session = 7
        self.uno.write(encode(Hello(0, DRIVE, 5), board=DRIVE, seq=0, session=7))
        (ack,) = [x for x in self.run(0.05) if isinstance(x, HelloAck)]
        return ResetCause(ack.reset_cause)


@pytest.fixture(params=["bare", "bootloader"])
def line(request, firmware_images):
    uno = SimulatedUno(firmware_images, "drive")
    if request.param == "bootloader":
        uno.have_bootloader()
    yield Line(uno)
    uno.close()


@pytest.mark.slow
def test_the_reset_cause_outlives_a_bootloader(line):
    line.run(0.03)
    assert line.reset_cause() is ResetCause.POWER_ON
    line.uno.reset()
    line.run(0.03)
    assert line.reset_cause() is ResetCause.EXTERNAL
    line.uno.hang()
    line.run(0.2)
    assert line.reset_cause() is ResetCause.WATCHDOG
    line.uno.reset()
    line.run(0.03)
    assert line.reset_cause() is ResetCause.EXTERNAL


@pytest.mark.slow
def test_a_frame_that_a_reset_cuts_does_not_swallow_the_boot(line):
    line.run(0.05)
    line.run(0.002)
    for k in range(20):  # somewhere in a state frame, which takes 3 ms of a tick
        line.run(0.0005)
        line.uno.reset()
        boots = [x for x in line.run(0.05) if isinstance(x, Event) and x.code == EventCode.BOOT]
        assert len(boots) == 1, k


@pytest.mark.slow
def test_a_broken_wire_of_the_potentiometer_turns_the_measured_rate_to_the_right(driving):
    """From the left it is a step of more than 16 bits hold."""
    assert driving.angle > 0.25
    broken = driving.unos[STEER]
    broken.steering_angle(-9.0)  # 0 V
    broken.steering_angle = lambda _: None
    rates = []
    for _ in range(5):
        driving.run(0.01)
        rates.append(driving.telemetry(STEER).rate)
    assert min(rates) == -32768
    assert max(rates[1:]) <= 0


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


def _as_the_ide_does(sketch, core, elf):
    """Compile a sketch's folder with the core's flags and link it with an archive like the core."""
    objects = []
    for source in sorted(sketch.glob("*.c")):
        compiler, obj = ["avr-gcc", *C_FLAGS], core / f"{sketch.name}.{source.name}.o"
        subprocess.run([*compiler, *CORE_FLAGS, "-o", obj, source], check=True)
        objects.append(obj)
    ino = core / f"{sketch.name}.ino.o"
    source = ["-I", core, "-include", "Arduino.h", "-x", "c++", sketch / f"{sketch.name}.ino"]
    subprocess.run(["avr-g++", *CPP_FLAGS, *CORE_FLAGS, "-o", ino, *source], check=True)
    archive = core / "core.a"
    subprocess.run(["avr-gcc", *LINK_FLAGS, "-o", elf, ino, *objects, archive, "-lm"], check=True)


@pytest.mark.slow
def test_the_sketch_of_the_arduino_ide_is_the_firmware(firmware_images, tmp_path):
    command = ["make", "-s", "-C", FIRMWARE, "sketch", f"BUILD={tmp_path / 'sketches'}"]
    subprocess.run(command, check=True)
    core, build = tmp_path / "core", tmp_path / "build"
    core.mkdir()
    build.mkdir()
    (core / "Arduino.h").write_text("#include <avr/io.h>\n")
    (core / "main.cpp").write_text(CORE)
    compiler = ["avr-g++", *CPP_FLAGS, *CORE_FLAGS]
    subprocess.run([*compiler, "-o", core / "main.o", core / "main.cpp"], check=True)
    subprocess.run(["avr-gcc-ar", "rcs", core / "core.a", core / "main.o"], check=True)
    (build / "libmachine.so").symlink_to(firmware_images / "libmachine.so")
    for name in ("steer", "drive"):
        assert (tmp_path / "sketches" / name / f"{name}.ino").exists()
        _as_the_ide_does(tmp_path / "sketches" / name, core, build / f"{name}.elf")
    for board, name in ((STEER, "steer"), (DRIVE, "drive")):
        uno = SimulatedUno(build, name)
        line = Line(uno)
        line.decoder = FrameDecoder(board, host=True)
        line.run(0.05)
        line.decoder.session = 7
        uno.write(encode(Hello(0, board, 5), board=board, seq=0, session=7))
        answers = line.run(0.05)
        uno.close()
        assert any(isinstance(x, HelloAck) and x.board == board for x in answers)
