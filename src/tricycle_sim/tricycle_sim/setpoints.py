"""Set-points as the PLCs make them: commands looked up and slewed on 100 Hz ticks.

The batch, the live vehicle's callers and the emulated PLCs all slew through `slew`.
"""

import numpy as np
from numpy.typing import NDArray

from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands
from tricycle_sim.compilation import compiled


@compiled
def slew(setpoint: float, target: float, rate: float) -> float:
    """Return the set-point one tick closer to its target.

    Parameters
    ----------
    setpoint, target : float
        Now and wanted, in the same unit.
    rate : float
        Largest change per second.
    """
    reach = rate * TICK
    if abs(target - setpoint) <= reach:
        return target
    return setpoint + reach if target > setpoint else setpoint - reach


def tick_count(duration: float) -> int:
    """Return the number of whole ticks in a duration.

    Parameters
    ----------
    duration : float
        Duration [s].
    """
    return int(np.floor(duration / TICK + 1e-6))


def command_rows(commands: Commands) -> NDArray[np.int64]:
    """Return for every tick, shape (t,), the newest row whose time has come.

    Parameters
    ----------
    commands : Commands
        Each held until the next.
    """
    ticks = np.arange(tick_count(commands.duration)) * TICK
    return np.searchsorted(commands.time, ticks + 1e-6 * TICK, side="right") - 1


@compiled
def slew_all(targets: FloatArray, rate: float, start: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """Slew through the target of each tick.

    Parameters
    ----------
    targets : ndarray of float, shape (t,)
        One per tick.
    rate : float
        Largest change per second.
    start : float
        Set-point before the first tick.

    Returns
    -------
    setpoints : ndarray of float, shape (t,)
        One per tick.
    lag : ndarray of float, shape (t,)
        Distance to the target beyond what the next tick makes up for, else 0.
    """
    setpoints = np.empty_like(targets)
    lag = np.zeros_like(targets)
    setpoint = start
    for k in range(targets.shape[0]):
        setpoint = slew(setpoint, targets[k], rate)
        setpoints[k] = setpoint
        behind = abs(targets[k] - setpoint)
        if behind > rate * TICK * (1.0 + 1e-6):
            lag[k] = behind
    return setpoints, lag


def delayed(setpoints: FloatArray, delay: float, before: float) -> FloatArray:
    """Return the set-points of consecutive ticks after a delay, interpolated between ticks.

    They are continuous in the delay, as a search for it needs: `before` is that of the tick before
    the first one.

    Parameters
    ----------
    setpoints : ndarray of float, shape (t,)
        Set-point at each tick.
    delay : float
        Delay [s].
    before : float
        Set-point until the first one is heard.
    """
    ticks = np.arange(-1, len(setpoints)) * TICK
    heard: FloatArray = np.interp(ticks[1:] - delay, ticks, np.append(before, setpoints))
    return heard
