"""Stopping distances of the tricycle, as the suite publishes them.

They hold for the tricycle of the suite with up to 30 kg of load on slopes of up to 5 %, with a
friction brake that works.
`benchmarks/stopping.py` measures them, `benchmarks/fault_soak.py` checks them under faults.
"""

import enum
from dataclasses import dataclass
from typing import TypeVar

from tricycle_core.quantities import FloatArray

Speed = TypeVar("Speed", float, FloatArray)


class Cause(enum.Enum):
    """Event that makes the vehicle stop."""

    ESTOP = "e-stop"
    DISARM = "DISARM"
    KILLED = "host killed"
    DISABLED = "enable = 0"


@dataclass(frozen=True)
class StoppingLaw:
    """A stop: a delay at constant speed, then the smallest deceleration that is guaranteed.

    Attributes
    ----------
    delay : float
        Time before the deceleration begins [s].
    deceleration : float
        Deceleration after the delay [m/s^2].
    margin : float
        Additional distance [m]: the motor may still push when the stop begins.
    """

    delay: float
    deceleration: float
    margin: float = 0.2

    def distance(self, speed: Speed) -> Speed:
        """Return the distance until the vehicle rests [m].

        Parameters
        ----------
        speed : float or ndarray of float
            Speed at the beginning of the stop [m/s].
        """
        return self.margin + speed * self.delay + speed**2 / (2.0 * self.deceleration)


BRAKED = StoppingLaw(delay=0.05, deceleration=0.47)
"""Motor off and full brake: the drive board has left ARMED for any state but STOPPING."""
RAMPED = StoppingLaw(delay=0.4, deceleration=1.1)
"""The drive board is in STOPPING."""

MAX_PAYLOAD = 30.0  # kg
DETECTION = 1.0
"""Longest time between a fault that stops the vehicle and the drive board's leaving ARMED [s]."""
LINE_DETECTION = 0.1
"""The same for a broken or shorted wire of the hall sensor [s]."""

_LAWS = {
    Cause.ESTOP: (0.05, BRAKED),
    Cause.DISARM: (0.05, BRAKED),
    Cause.KILLED: (0.25, RAMPED),
    Cause.DISABLED: (0.05, RAMPED),
}


def stopping_distance(cause: Cause, speed: Speed) -> Speed:
    """Return the distance from the event until the vehicle rests [m].

    Parameters
    ----------
    cause : Cause
        Event that makes the vehicle stop.
    speed : float or ndarray of float
        Speed at the event [m/s].
    """
    reaction, law = _LAWS[cause]
    return speed * reaction + law.distance(speed)
