"""The simulated tricycle with the real firmware: two simulated UNOs and the live vehicle.

As `tricycle_sim.simulator`, but for the boards: theirs is the C code of `firmware/`, whose speed
controller makes the motor's torque; the vehicle is the plant.
"""

from pathlib import Path

from tricycle_bridge.framing import FrameDecoder
from tricycle_bridge.messages import (
    TICK,
    Board,
    DriveCommand,
    DriveState,
    Hello,
    PlcState,
    SteerCommand,
    SteerState,
)
from tricycle_sim.live import LiveState, LiveVehicle
from tricycle_sim.simulated_avr import SimulatedUno
from tricycle_sim.vehicle import Vehicle

_TICK_US = round(TICK * 1e6)


class _FirmwareBoard:
    """One simulated UNO, and what its line tells of its state."""

    def __init__(self, board: Board, build: Path) -> None:
        self._board = board
        self._build = build
        self._boot()

    def _boot(self) -> None:
        self.uno = SimulatedUno(self._build, self._board.name.lower())
        self.armed = False
        self.heard = False  # a command since the last step
        self._sent = FrameDecoder(self._board, host=False)
        self._received = FrameDecoder(self._board, host=True)

    def reboot(self) -> None:
        """Take the power away and give it back."""
        self.uno.close()
        self._boot()

    def write(self, data: bytes) -> None:
        """Send bytes of the host to the board."""
        for frame in self._sent.feed(data):
            if isinstance(frame.message, Hello):
                self._sent.session = self._received.session = frame.session
            self.heard |= isinstance(frame.message, SteerCommand | DriveCommand)
        self.uno.write(data)

    def run(self, until_us: int) -> bytes:
        """Run to a time since the boot; return what the board has sent."""
        self.uno.run(until_us)
        self.heard = False
        data = self.uno.read()
        for frame in self._received.feed(data):
            if isinstance(frame.message, SteerState | DriveState):
                self.armed = frame.message.state == PlcState.ARMED
        return data


class FirmwareSimulator:
    """Vehicle, steer board and drive board on one clock that `step` moves on by 10 ms.

    Parameters
    ----------
    vehicle
        With its true values.
    build
        Directory of the firmware's images and the simulator: `make -C firmware avr simulator`.

    Raises
    ------
    LinkError
        If they are not there.
    """

    def __init__(self, vehicle: Vehicle, build: Path) -> None:
        self._vehicle = vehicle
        self._boards = {b: _FirmwareBoard(b, build) for b in (Board.STEER, Board.DRIVE)}
        self._ticks = 0
        self._boot_tick = 0
        self._live = LiveVehicle(vehicle)

    @property
    def time(self) -> float:
        """Simulated time in s; it never goes back."""
        return self._ticks * TICK

    @property
    def state(self) -> LiveState:
        """The vehicle's state at `time`."""
        return self._live.state

    @property
    def armed(self) -> bool:
        """Whether both boards' newest telemetry says so."""
        return all(board.armed for board in self._boards.values())

    @property
    def answered(self) -> bool:
        """Whether both boards were sent a command since the last step."""
        return all(board.heard for board in self._boards.values())

    def heard(self, board: Board) -> bool:
        """Whether a board was sent a command since the last step."""
        return self._boards[board].heard

    def reset(self) -> None:
        """Put the vehicle at rest at the origin and power-cycle both boards; time goes on."""
        self._live = LiveVehicle(self._vehicle)
        self._boot_tick = self._ticks
        for board in self._boards.values():
            board.reboot()

    def receive(self, board: Board, data: bytes) -> bytes:
        """Hand bytes of the host to a board; its answers come with the telemetry of `step`."""
        self._boards[board].write(data)
        return b""

    def step(self) -> dict[Board, bytes]:
        """Run one tick: sensors, boards, vehicle. Return what the boards sent."""
        state, steer, drive = self._live.state, *self._boards.values()
        steer.uno.steering_angle(state.steering_motor_angle)
        drive.uno.wheel_speed(state.wheel_speeds[2] * self._vehicle.tyre_radius)
        until = (self._ticks + 1 - self._boot_tick) * _TICK_US
        sent = {board: one.run(until) for board, one in self._boards.items()}
        servo, motor = steer.uno.steer_pins(), drive.uno.drive_pins()
        self._live.step(
            steering=servo.angle if servo.servo_on else None,
            torque=motor.torque,
            brake=motor.brake,
        )
        self._ticks += 1
        return sent

    def close(self) -> None:
        """Free the simulated boards."""
        for board in self._boards.values():
            board.uno.close()
