"""The real firmware on a simulated ATmega328P (libsimavr), one board per `SimulatedUno`.

Build with ``make -C firmware avr simulator``. Time is the board's own; only `run` advances it.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from pathlib import Path

from tricycle_bridge.protocol.boards import (
    ADC_CENTRE,
    ADC_SCALE,
    DRIVE_SUPPLY,
    HALL_PULSE,
    PWM_TOP,
    SERVO_CENTRE,
    SERVO_SPAN,
    STEER_SUPPLY,
    SUPPLY_DIVIDER,
)
from tricycle_bridge.protocol.limits import MAX_TORQUE, STEERING_END_STOP
from tricycle_core.closing import Closing
from tricycle_core.errors import LinkError

_LINE = 16384  # bytes
_MV_PER_COUNT = 5000.0 / 1024
# data memory addresses of the ATmega328P
_DDRB, _PORTB, _PORTD, _TCCR1A, _OCR1A, _OCR1B = 0x24, 0x25, 0x2B, 0x80, 0x88, 0x8A
_COM1A1, _COM1B1, _PB0, _PB2, _PD7 = 0x80, 0x20, 0x01, 0x04, 0x80


@dataclass(frozen=True)
class SteerPins:
    """Outputs of the steer board.

    Attributes
    ----------
    servo_on : bool
        Whether the servo gets pulses.
    angle : float
        Angle of the steering motor that the pulse commands, in rad.
    """

    servo_on: bool
    angle: float


@dataclass(frozen=True)
class DrivePins:
    """Outputs of the drive board.

    Attributes
    ----------
    torque : float
        Torque demanded of the motor in N m, forward positive, without a throttle range in SETUP.
    brake : float
        Brake command, 0 (released) to 1 (full).
    """

    torque: float
    brake: float


def check_build(build: Path) -> None:
    """Check that a directory has the images and the simulator.

    Parameters
    ----------
    build : Path
        Directory with the build.

    Raises
    ------
    LinkError
        If a file is missing; the message names the first.
    """
    for name in ("steer.elf", "drive.elf", "libmachine.so"):
        if not (build / name).exists():
            raise LinkError(f"{build / name} does not exist: `make firmware` builds it")


class SimulatedUno(Closing):
    """One UNO running a firmware image.

    Parameters
    ----------
    build : Path
        Directory of ``steer.elf``, ``drive.elf`` and ``libmachine.so``.
    name : str
        ``steer`` or ``drive``.

    Raises
    ------
    LinkError
        The image or the simulator is not there, or the image is none.
    """

    def __init__(self, build: Path, name: str) -> None:
        check_build(build)
        self._c = ctypes.CDLL(str(build / "libmachine.so"))
        self._c.machine_new.restype = ctypes.c_void_p
        self._c.machine_word.restype = ctypes.c_uint16
        image = build / f"{name}.elf"
        self._machine = ctypes.c_void_p(self._c.machine_new(str(image).encode()))
        if not self._machine:
            raise LinkError(f"{image}: is not a firmware image: `make firmware` builds it")
        self.supply(DRIVE_SUPPLY if name == "drive" else STEER_SUPPLY)
        self.estop(pressed=False)
        self._c.machine_sensor(self._machine, 0, 0)  # half a pulse before its edge
        self._c.machine_sensor(self._machine, 1, 1)

    def close(self) -> None:
        """Free the simulation."""
        if self._machine:
            self._c.machine_free(self._machine)
        self._machine = ctypes.c_void_p()

    def run(self, until_us: int) -> None:
        """Run to a time on the board's clock.

        Parameters
        ----------
        until_us : int
            The time in us.

        Raises
        ------
        LinkError
            The program crashed.
        """
        if not self._c.machine_run(self._machine, ctypes.c_uint64(until_us)):
            raise LinkError("the firmware crashed")

    def reset(self) -> None:
        """Reset the board, as its button does."""
        self._c.machine_reset(self._machine)

    def hang(self) -> None:
        """Let the program tick no more; its watchdog resets it."""
        self._c.machine_hang(self._machine)

    def have_bootloader(self) -> None:
        """Let a bootloader clear the cause of every reset from now on, as a UNO's does."""
        self._c.machine_bootloader(self._machine)

    def write(self, data: bytes) -> None:
        """Send bytes to the board; they arrive at the line's rate."""
        self._c.machine_write(self._machine, data, len(data))

    def read(self) -> bytes:
        """Return what the board has sent."""
        out = ctypes.create_string_buffer(_LINE)
        length = self._c.machine_read(self._machine, out)
        return out.raw[:length]

    # ---- inputs ----

    def estop(self, *, pressed: bool) -> None:
        """Open or close the e-stop's contact."""
        self._c.machine_pin(self._machine, 3, int(pressed))

    def supply(self, volts: float) -> None:
        """Set the supply voltage."""
        self._adc(1, volts * 1e3 / SUPPLY_DIVIDER)

    def steering_angle(self, angle: float) -> None:
        """Turn the potentiometer (rad)."""
        self._adc(0, (ADC_CENTRE + ADC_SCALE * angle + 0.5) * _MV_PER_COUNT)

    def wheel_speed(self, speed: float, pulse: float = HALL_PULSE) -> None:
        """Set the speed at which the hall sensor's wheel turns.

        Parameters
        ----------
        speed : float
            Speed of the tread [m/s], forward positive.
        pulse : float
            Travel per pulse [m].
        """
        self._c.machine_sensor(self._machine, 1, int(speed >= 0.0))
        self._c.machine_hall(self._machine, ctypes.c_double(abs(speed) / pulse))

    def hall_lines(self, hall: float | None, direction: float | None) -> None:
        """Break the hall sensor's lines.

        Parameters
        ----------
        hall, direction : float or None
            Their voltages [V]; None: whole.
        """
        for line, volts in enumerate((hall, direction)):
            millivolts = -1 if volts is None else round(volts * 1e3)
            self._c.machine_break(self._machine, line, ctypes.c_int32(millivolts))

    def _adc(self, channel: int, millivolts: float) -> None:
        self._c.machine_adc(self._machine, channel, max(round(millivolts), 0))

    # ---- outputs ----

    def _word(self, address: int) -> int:
        return int(self._c.machine_word(self._machine, ctypes.c_uint16(address)))

    @property
    def alive(self) -> bool:
        """Level of the alive output, which toggles while the board is armed or stopping."""
        return bool(self._word(_PORTB) & _PB0)

    def steer_pins(self) -> SteerPins:
        """Read the servo's pulse."""
        on = bool(self._word(_TCCR1A) & _COM1A1)
        pulse = self._word(_OCR1A) / 16  # us
        return SteerPins(on, (pulse - SERVO_CENTRE) * STEERING_END_STOP / SERVO_SPAN if on else 0.0)

    def drive_pins(self) -> DrivePins:
        """Read motor and brake."""
        mode = self._word(_TCCR1A)
        torque = self._word(_OCR1A) / PWM_TOP * MAX_TORQUE if mode & _COM1A1 else 0.0
        backward = bool(self._word(_PORTD) & _PD7)
        if mode & _COM1B1:
            brake = self._word(_OCR1B) / PWM_TOP
        else:  # a resistor pulls the pin up while it floats
            brake = float(not self._word(_DDRB) & _PB2)
        return DrivePins(-torque if backward else torque, brake)
