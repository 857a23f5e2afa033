"""The rig with the real firmware: two simulated UNOs and the live vehicle.

The boards run the C code of `firmware/`, whose speed controller makes the motor's torque; the
vehicle is the plant.
"""

from pathlib import Path

from tricycle_bridge.protocol.boards import (
    ADC_CENTRE,
    ADC_SCALE,
    STEER_SUPPLY,
    hall_pulse,
)
from tricycle_bridge.protocol.framing import FrameDecoder
from tricycle_bridge.protocol.messages import (
    Board,
    DriveCommand,
    DriveState,
    Fault,
    Hello,
    PlcState,
    ResetCause,
    SteerCommand,
    SteerState,
)
from tricycle_core.timing import TICK
from tricycle_sim.plants.plant import Plant
from tricycle_sim.plc.simulated_uno import SimulatedUno
from tricycle_sim.rig.faults import NO_FAULTS, FaultKind, FaultPlan
from tricycle_sim.rig.rig import Rig
from tricycle_sim.rig.sensors import broken_lines, broken_potentiometer, measured_speed
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.live import LiveState

_TICK_US = round(TICK * 1e6)
# The boards tick so long after the vehicle. A command that is sent at a tick then acts in it, as
# the emulation's do, though it takes 1.7 ms on the line, and the state frame is sent in it too. A
# ping takes 2.5 ms there, which the bridge's stamps leave out: later ticks would be stamped late.
_BEHIND_US = 3000
# They were switched on so long before the vehicle's first tick, and have booted.
_LEAD_US = 2 * _TICK_US - _BEHIND_US


class _FirmwareBoard:
    """One simulated UNO, and its state as its messages report it."""

    def __init__(self, board: Board, build: Path) -> None:
        self._board = board
        self._build = build
        self.uno = self._booted()
        self._begin()

    def _booted(self) -> SimulatedUno:
        uno = SimulatedUno(self._build, self._board.name.lower())
        uno.run(_LEAD_US)
        return uno

    def _begin(self) -> None:
        self._time = _LEAD_US
        self.state, self.faults = PlcState.BOOT, Fault(0)
        self.heard = False  # a command since the last step
        self._sent = FrameDecoder(self._board, host=False)
        self._received = FrameDecoder(self._board, host=True)

    def replace(self) -> None:
        """Put another board in its place, fresh from the flashing; if none boots, it stays."""
        before, self.uno = self.uno, self._booted()
        before.close()
        self._begin()

    def write(self, data: bytes) -> None:
        """Send bytes of the host to the board."""
        for frame in self._sent.feed(data):
            if isinstance(frame.message, Hello):
                self._sent.session = self._received.session = frame.session
            self.heard |= isinstance(frame.message, SteerCommand | DriveCommand)
        self.uno.write(data)

    def step(self) -> bytes:
        """Run for a tick; return what the board has sent."""
        self._time += _TICK_US
        self.uno.run(self._time)
        self.heard = False
        data = self.uno.read()
        for frame in self._received.feed(data):
            if isinstance(frame.message, SteerState | DriveState):
                self.state = PlcState(frame.message.state)
                self.faults = Fault(frame.message.faults)
        return data


class FirmwareRig(Rig):
    """The rig with the real firmware on two simulated UNOs.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with its true values.
    build : Path
        Directory of the firmware's images and the simulator: `make -C firmware avr simulator`.
    faults : FaultPlan
        Faults of wires, boards and host. A board that is reset is one fresh from the flashing.
    plant : Plant, optional
        Plant that the boards drive; by default our own model of the vehicle.

    Raises
    ------
    LinkError
        If the files of the build are missing.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        build: Path,
        faults: FaultPlan = NO_FAULTS,
        plant: Plant | None = None,
    ) -> None:
        self._boards = {b: _FirmwareBoard(b, build) for b in (Board.STEER, Board.DRIVE)}
        self._hall_travel = 0.0  # m that the hall sensor's wheel has turned
        super().__init__(vehicle, faults, plant)

    def plc_state(self, board: Board) -> PlcState:
        """Return a board's state, of its newest telemetry."""
        return self._boards[board].state

    def plc_faults(self, board: Board) -> Fault:
        """Return a board's faults, of its newest telemetry."""
        return self._boards[board].faults

    def heard(self, board: Board) -> bool:
        """Whether a board was sent a command since the last step."""
        return self._boards[board].heard

    def _rest(self) -> None:
        self._hall_travel = 0.0

    def _reboot(self, board: Board, _: ResetCause) -> None:
        self._boards[board].replace()

    def _receive(self, board: Board, data: bytes) -> bytes:
        self._boards[board].write(data)
        return b""  # the answers come with the telemetry of `step`

    def _step(self, hung: set[Board]) -> dict[Board, bytes]:
        state, faults = self._state, self._faults
        steer, drive = self._boards.values()
        counts = broken_potentiometer(faults)
        steer.uno.steering_angle(
            state.steering_motor_angle if counts is None else (counts - ADC_CENTRE) / ADC_SCALE
        )
        speed = measured_speed(self._hall_speed(state), faults)
        drive.uno.wheel_speed(speed, hall_pulse(self._vehicle.driven_radius))
        drive.uno.hall_lines(*broken_lines(faults))
        steer.uno.supply(faults.get(FaultKind.STEER_SUPPLY, STEER_SUPPLY))
        drive.uno.supply(faults.get(FaultKind.DRIVE_SUPPLY, self._vehicle.battery_voltage))
        for board in (steer, drive):
            board.uno.estop(pressed=FaultKind.ESTOP in faults)
        sent = {board: b"" if board in hung else one.step() for board, one in self._boards.items()}
        servo, motor = steer.uno.steer_pins(), drive.uno.drive_pins()
        servo_on = servo.servo_on and FaultKind.SERVO_DEAD not in faults
        self._advance(
            servo.angle if servo_on else None,
            0.0 if FaultKind.MOTOR_DEAD in faults else motor.torque,
            0.0 if FaultKind.BRAKE_DEAD in faults else motor.brake,
        )
        return sent

    def _hall_speed(self, state: LiveState) -> float:
        """Return the speed of the hall sensor's wheel in the coming tick [m/s].

        The wheel's, corrected so that the sensor is where the wheel is now by the boards' tick.
        """
        radius = self._vehicle.driven_radius
        speed = state.drive_speed * radius
        wanted = state.drive_angle * radius - speed * _BEHIND_US * 1e-6
        speed += (wanted - self._hall_travel) / TICK
        self._hall_travel += speed * TICK
        return speed

    def close(self) -> None:
        """Free the simulated boards and the plant."""
        super().close()
        for board in self._boards.values():
            board.uno.close()
