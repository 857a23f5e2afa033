"""Faults of wires, boards and host that a rig puts between vehicle, boards and host."""

import enum
import math
from dataclasses import dataclass

from tricycle_bridge.protocol.boards import HARDWARE_WATCHDOG
from tricycle_core.timing import TICK


class FaultKind(enum.Enum):
    """Kind of fault: the part that fails."""

    HALL_OPEN = "hall wire broken"  # no pulses; the pull-up's voltage
    HALL_SHORT = "hall wire shorted to ground"  # no pulses; no voltage
    HALL_STUCK = "hall sensor stuck"  # no pulses; a valid level
    DIRECTION_OPEN = "hall direction wire broken"  # the pull-up reads forward
    DIRECTION_STUCK = "hall direction sensor stuck"  # forward, a valid level
    HALL_HALF = "every second hall pulse lost"
    POTENTIOMETER_LOW = "potentiometer wire broken, reads 0"
    POTENTIOMETER_HIGH = "potentiometer wire broken, reads 1023"
    MOTOR_DEAD = "motor wire broken"  # no torque
    BRAKE_DEAD = "brake wire broken"  # no brake
    SERVO_DEAD = "servo wire broken"  # no pulses: the gear holds the angle
    ESTOP = "e-stop pressed"
    STEER_SUPPLY = "supply of the steer board"  # value: V
    DRIVE_SUPPLY = "supply of the drive board"  # value: V
    STEER_RESET = "steer board reset"
    DRIVE_RESET = "drive board reset"
    STEER_HANG = "steer board hangs"  # until its hardware watchdog resets it
    DRIVE_HANG = "drive board hangs"
    STEER_CABLE = "cable of the steer board pulled"  # plugged in again, it resets the board
    DRIVE_CABLE = "cable of the drive board pulled"
    HOST_SILENT = "host silent"  # killed: it neither sends nor reads
    HOST_CLOCK = "step of the host's clock"  # value: s


_LENGTHS = {
    FaultKind.STEER_RESET: TICK,
    FaultKind.DRIVE_RESET: TICK,
    FaultKind.STEER_HANG: HARDWARE_WATCHDOG,
    FaultKind.DRIVE_HANG: HARDWARE_WATCHDOG,
}


@dataclass(frozen=True)
class RigFault:
    """One fault.

    Attributes
    ----------
    kind : FaultKind
        Part that fails, and how.
    start : float
        Time at which it begins, in the rig's time [s].
    end : float
        Time at which it is repaired [s]. A reset is over at once, a hang with the hardware
        watchdog's reset.
    value : float
        Supply in V or step of the clock in s; other kinds have none.
    """

    kind: FaultKind
    start: float
    end: float = math.inf
    value: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.start < self.end:
            raise ValueError(f"{self.kind.value}: from {self.start:g} s to {self.end:g} s")

    def active(self, time: float) -> bool:
        """Return whether the fault is there at a time.

        Parameters
        ----------
        time : float
            The rig's time [s].
        """
        end = self.start + _LENGTHS[self.kind] if self.kind in _LENGTHS else self.end
        return self.start <= time + 1e-9 < end


@dataclass(frozen=True)
class FaultPlan:
    """The faults of a drive.

    Attributes
    ----------
    faults : tuple of RigFault
        Faults in any order; of two of a kind at the same time the first counts.
    """

    faults: tuple[RigFault, ...] = ()

    def at(self, time: float) -> dict[FaultKind, float]:
        """Return the value of each kind of fault that is there at a time.

        Parameters
        ----------
        time : float
            The rig's time [s].
        """
        return {fault.kind: fault.value for fault in reversed(self.faults) if fault.active(time)}


NO_FAULTS = FaultPlan()
