"""Sensor readings as they reach the boards, over intact and broken wires."""

import math

from tricycle_bridge.protocol.boards import LINE_OPEN, LINE_RESTING
from tricycle_sim.rig.faults import FaultKind

_NO_PULSES = {FaultKind.HALL_OPEN, FaultKind.HALL_SHORT, FaultKind.HALL_STUCK}
_FORWARD = {FaultKind.DIRECTION_OPEN, FaultKind.DIRECTION_STUCK}


class HallSensor:
    """Pulses as the drive board counts them.

    Parameters
    ----------
    pulse : float
        Travel per pulse [m].

    Attributes
    ----------
    count : int
        Pulses so far; forward counts up.
    edge_at : float
        Time of the newest one [s].
    """

    def __init__(self, pulse: float) -> None:
        self._pulse = pulse
        self.count = 0
        self.edge_at = 0.0
        self._travel = 0.0  # m
        self._time = 0.0  # s
        self._edge = 0  # true number of the newest edge

    def turn(self, travel: float, time: float, faults: dict[FaultKind, float]) -> None:
        """Turn the wheel further.

        Parameters
        ----------
        travel : float
            Travel of the tread since the start [m].
        time : float
            Time at which this travel is reached [s].
        faults : dict of FaultKind to float
            Faults that act now, with their values.
        """
        # half a pulse before its first edge at the start
        edge = math.floor(travel / self._pulse + 0.5)
        low, high = sorted((self._edge, edge))  # the edges from low + 1 to high have passed
        every = 2 if FaultKind.HALL_HALF in faults else 1
        passed = high // every - low // every
        if passed and not _NO_PULSES & faults.keys():
            forward = edge > self._edge
            newest = every * (high // every if forward else low // every + 1)
            place = (newest - 0.5) * self._pulse
            share = (place - self._travel) / (travel - self._travel)
            self.edge_at = self._time + min(max(share, 0.0), 1.0) * (time - self._time)
            self.count += passed if forward or _FORWARD & faults.keys() else -passed
        self._edge, self._travel, self._time = edge, travel, time


def measured_speed(speed: float, faults: dict[FaultKind, float]) -> float:
    """Return the speed that follows from the pulses that reach the board [m/s].

    Parameters
    ----------
    speed : float
        Speed at the tread [m/s].
    faults : dict of FaultKind to float
        Faults that act now, with their values.
    """
    if _NO_PULSES & faults.keys():
        return 0.0
    if FaultKind.HALL_HALF in faults:
        speed /= 2.0
    return abs(speed) if _FORWARD & faults.keys() else speed


def broken_lines(faults: dict[FaultKind, float]) -> tuple[float | None, float | None]:
    """Return the hall sensor's line voltages, pulse and direction [V]; None: the line is intact.

    Parameters
    ----------
    faults : dict of FaultKind to float
        Faults that act now, with their values.
    """
    hall = None
    if FaultKind.HALL_OPEN in faults:
        hall = LINE_OPEN
    elif FaultKind.HALL_SHORT in faults:
        hall = 0.0
    return hall, LINE_OPEN if FaultKind.DIRECTION_OPEN in faults else None


def line_voltages(faults: dict[FaultKind, float]) -> tuple[float, float]:
    """Return the voltages of the hall sensor's lines, pulse and direction [V].

    Parameters
    ----------
    faults : dict of FaultKind to float
        Faults that act now, with their values.
    """
    hall, direction = (
        level if broken is None else broken
        for level, broken in zip(LINE_RESTING, broken_lines(faults), strict=True)
    )
    return hall, direction


def broken_potentiometer(faults: dict[FaultKind, float]) -> int | None:
    """Return the counts of a potentiometer with a broken wire; None if it is intact.

    Parameters
    ----------
    faults : dict of FaultKind to float
        Faults that act now, with their values.
    """
    if FaultKind.POTENTIOMETER_LOW in faults:
        return 0
    return 1023 if FaultKind.POTENTIOMETER_HIGH in faults else None
