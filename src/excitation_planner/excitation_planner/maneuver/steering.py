"""Maneuver families that prescribe the steering itself, after the open-loop tests of ISO 7401.

Constant speed, straight ahead, then a steering input as a function of time. There is no path to
track, so these give `Commands`; the nominal vehicle's motion under them is the reference. The
standard's speeds and lateral accelerations are a car's: the ranges here are those of a tricycle.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from excitation_planner.box import Box
from excitation_planner.maneuver.family import (
    ACCELERATION,
    COMMAND_TICKS,
    SETTLING_TIME,
    check_speed,
)
from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import Vehicle

STEP_OPERATION = Box.of({"angle": (0.05, 0.6), "speed": (0.8, 2.5)})  # rad, m/s
SWEEP_OPERATION = Box.of({"amplitude": (0.05, 0.4), "frequency": (0.4, 2.0)})  # rad, Hz


def steered(
    vehicle: Vehicle, speed: float, angle: Callable[[FloatArray], FloatArray], *, duration: float
) -> Commands:
    """Return the commands of a run-in straight ahead to a speed, then a steering input.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle; its acceleration limits the run-in.
    speed : float
        Speed held after the run-in [m/s].
    angle : callable
        Steering motor angle (t,) [rad], left positive, at times (t,) [s] after the run-in.
    duration : float
        Time after the run-in [s].

    Raises
    ------
    PlanError
        If a maneuver cannot be driven at the speed.
    """
    check_speed(speed)
    acceleration = min(ACCELERATION, vehicle.acceleration)
    run_in = speed / acceleration + SETTLING_TIME
    period = COMMAND_TICKS * TICK
    time = period * np.arange(np.ceil((run_in + duration) / period) + 1)
    after = np.maximum(time - run_in, 0.0)
    return Commands(
        time,
        np.where(time > run_in, angle(after), 0.0),
        np.minimum(acceleration * (time + period), speed),
    )


@dataclass(frozen=True)
class StepSteer:
    """Step of the steering to the left: x = (steering motor angle in rad, speed in m/s).

    As fast as the steering slews, then held: the transient and the steady state.

    Attributes
    ----------
    operation : Box
        Ranges of x.
    duration : float
        Time from the step to the end [s].
    """

    operation: Box = STEP_OPERATION
    duration: float = 8.0
    name: ClassVar[str] = "step_steer"

    def drive(self, x: FloatArray, vehicle: Vehicle) -> Commands:
        """Return the run-in, the ramp at the vehicle's slew rate, and the hold.

        Parameters
        ----------
        x : ndarray of float, shape (2,)
            Steering motor angle [rad] and speed [m/s].
        vehicle : Vehicle
            Vehicle; only its nominal values count.
        """
        angle, speed = (float(v) for v in x)
        return steered(
            vehicle,
            speed,
            lambda t: np.minimum(vehicle.steering_slew * t, angle),
            duration=self.duration,
        )


@dataclass(frozen=True)
class SineSweep:
    """Sine of the steering whose frequency rises: x = (amplitude in rad, last frequency in Hz).

    The frequency rises linearly with time. About a turn instead of straight ahead, a sweep of any
    duration fits an area.

    Attributes
    ----------
    operation : Box
        Ranges of x.
    first_frequency : float
        Frequency at the beginning of the sweep [Hz].
    duration : float
        Duration of the sweep [s].
    speed : float
        Speed during the sweep [m/s].
    turn : float
        Steering motor angle about which it sweeps [rad]; approached at half the slew rate.
    """

    operation: Box = SWEEP_OPERATION
    first_frequency: float = 0.2
    duration: float = 15.0
    speed: float = 2.0
    turn: float = 0.0
    name: ClassVar[str] = "sine_sweep"

    def drive(self, x: FloatArray, vehicle: Vehicle) -> Commands:
        """Return the run-in and the sweep.

        Parameters
        ----------
        x : ndarray of float, shape (2,)
            Amplitude [rad] and last frequency [Hz].
        vehicle : Vehicle
            Vehicle; only its nominal values count.
        """
        amplitude, frequency = (float(v) for v in x)
        rise = (frequency - self.first_frequency) / self.duration  # Hz/s

        def angle(t: FloatArray) -> FloatArray:
            phase = 2.0 * np.pi * (self.first_frequency * t + 0.5 * rise * t**2)
            reach = 0.5 * vehicle.steering_slew * t
            return np.asarray(np.clip(self.turn, -reach, reach) + amplitude * np.sin(phase))

        return steered(vehicle, self.speed, angle, duration=self.duration)
