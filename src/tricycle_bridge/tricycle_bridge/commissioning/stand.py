"""The stand of a bring-up: both boards behind serial ports, driven by the bridge."""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Callable

from tricycle_bridge.arming import ArmingOutcome
from tricycle_bridge.bridge import BOARDS, Bridge
from tricycle_bridge.commands.command_stream import Source, VehicleCommand
from tricycle_bridge.port_bridge import receive_all, send_all
from tricycle_bridge.protocol.limits import STEERING_END_STOP
from tricycle_bridge.protocol.messages import (
    BAUD,
    Board,
    DriveLimits,
    DriveState,
    Op,
    StateFlag,
    SteerState,
)
from tricycle_bridge.protocol.readable import firmware_build
from tricycle_bridge.serial_port import SerialPorts
from tricycle_bridge.settings import BridgeSettings
from tricycle_core.closing import Closing
from tricycle_core.errors import LinkError

_POLL = 0.01  # s


class PortStand(Closing):
    """Both boards and the engineer, as a step sees them.

    Parameters
    ----------
    paths : dict of Board to str
        Serial device of each board.
    settings : BridgeSettings
        Settings of the bridge for the vehicle.
    say : callable
        Shows a text to the engineer.
    end_stop : float
        Angle of the steering motor at which the vehicle's steering ends, either side [rad].
    baud : int
        Bits per second.
    boot_wait : float
        Silence after opening a port [s].

    Attributes
    ----------
    say : callable
        Shows a text to the engineer.
    settings : BridgeSettings
        Settings of the bridge for the vehicle.
    end_stop : float
        Angle of the steering motor at which the vehicle's steering ends, either side [rad].
    """

    def __init__(
        self,
        paths: dict[Board, str],
        settings: BridgeSettings,
        say: Callable[[str], None],
        *,
        end_stop: float = STEERING_END_STOP,
        baud: int = BAUD,
        boot_wait: float = 2.0,
    ) -> None:
        self.say = say
        self.settings = settings
        self.end_stop = end_stop
        self._ready = threading.Event()
        self._command: VehicleCommand | None = None
        self._bridge = Bridge(settings, rng=random.SystemRandom(), boot_wait=boot_wait)
        self._bridge.active = True
        self._ports = SerialPorts(paths, self._ready.set, baud=baud)

    def connect(self, timeout: float) -> None:
        """Wait until both boards send telemetry and are set up.

        Parameters
        ----------
        timeout : float
            Longest time to wait [s].

        Raises
        ------
        LinkError
            Says what is missing.
        """

        def missing() -> list[str]:
            return [
                f"{board.plc_name}: {link.problem or 'no set-up'}"
                for board, link in self._bridge.links.items()
                if link.telemetry is None
                or not link.telemetry.flags & StateFlag.SET_UP
                or link.limits is None
            ]

        if not self.wait(timeout, lambda: not missing()):
            raise LinkError("; ".join(missing()))

    @property
    def steer(self) -> SteerState:
        """Newest telemetry of the steer PLC."""
        state = self._bridge.links[Board.STEER].telemetry
        if not isinstance(state, SteerState):
            raise LinkError("the steer PLC is lost")
        return state

    @property
    def drive(self) -> DriveState:
        """Newest telemetry of the drive PLC."""
        state = self._bridge.links[Board.DRIVE].telemetry
        if not isinstance(state, DriveState):
            raise LinkError("the drive PLC is lost")
        return state

    @property
    def limits(self) -> DriveLimits:
        """Limits in force in the drive PLC."""
        limits = self._bridge.links[Board.DRIVE].limits
        if not isinstance(limits, DriveLimits):
            raise LinkError("the drive PLC does not tell its limits")
        return limits

    def firmware(self, board: Board) -> str:
        """Return version and build of a board's firmware.

        Parameters
        ----------
        board : Board
            Board, steer or drive.
        """
        identity = self._bridge.links[board].identity
        if identity is None:
            raise LinkError(f"the {board.plc_name} is lost")
        return firmware_build(identity)

    def connected(self, board: Board) -> bool:
        """Whether a board's link is up."""
        link = self._bridge.links[board]
        return link.up and link.telemetry is not None

    def now(self) -> float:
        """Present time [s], from a clock that nobody sets."""
        return time.monotonic()

    def wait(self, seconds: float, until: Callable[[], bool]) -> bool:
        """Run until a condition holds or the time is over; return whether it holds.

        Parameters
        ----------
        seconds : float
            Longest time [s].
        until : callable
            Condition that is waited for.
        """
        end = self.now() + seconds
        while not until():
            if self.now() >= end:
                return False
            self._step()
        return True

    def arm(self) -> str | None:
        """Arm both boards; return why they refuse, None if they are armed."""
        outcomes: list[ArmingOutcome] = []
        self.wait(2.0, lambda: self._bridge.refusal(self.now()) is None)
        self._bridge.arm(self.now(), outcomes.append)
        self.wait(5.0, lambda: bool(outcomes))
        if outcomes and outcomes[0].armed:
            return None
        return outcomes[0].text if outcomes else "the boards do not answer"

    def command(self, angle: float, speed: float) -> None:
        """Set the command that is sent from now on.

        Parameters
        ----------
        angle : float
            Angle of the steering motor [rad].
        speed : float
            Speed of the wheel at its tread [m/s].
        """
        self._command = VehicleCommand(angle, speed)

    def silence(self) -> None:
        """Send no commands from now on."""
        self._command = None

    def disarm(self) -> None:
        """Disarm both boards."""
        self._command = None
        self._bridge.disarm(self.now())

    def emergency_stop(self) -> None:
        """Stop both boards by an ESTOP; the next `arm` ends it."""
        self._command = None
        self._bridge.emergency_stop(self.now())

    def clear(self) -> None:
        """Have both boards clear their faults."""
        for board in BOARDS:
            self._bridge.links[board].operate(Op.CLEAR, self.now())

    def close(self) -> None:
        """Disarm what can be reached and close both ports."""
        self.disarm()
        send_all(self._bridge, self._ports)
        self._ports.close()

    def _step(self) -> None:
        self._ready.wait(_POLL)
        self._ready.clear()
        now = self.now()
        receive_all(self._bridge, self._ports, now)
        if self._command is not None:
            refusal = self._bridge.set_command(
                self._command, stamp=now, now=now, source=Source.JOINT_COMMANDS, name="bring-up"
            )
            if refusal is not None:
                raise LinkError(refusal)
        send_all(self._bridge, self._ports)
