"""The vehicle file's servo, linkage and motor, for plants whose own equations lack them."""

import math

import numpy as np

from tricycle_core.timing import TICK
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.kernel import functions_for
from tricycle_sim.vehicle.parts import servo_at_rest, steering_constants
from tricycle_sim.vehicle.speed_loop import motor_law

_BEHIND_PLAY = 2  # of a geared servo's state


class SteeringServo:
    """The steering servo with its linkage, at rest straight ahead.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with the laws and constants of servo and linkage.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self._functions = functions_for(vehicle)
        self._constants = steering_constants(vehicle, 0.5 * TICK)
        self._servo = servo_at_rest(vehicle)
        self._table, self._angles = np.empty((3, 8)), np.empty((2, 2))

    @property
    def motor(self) -> tuple[float, float]:
        """Angle and rate of the motor [rad, rad/s]."""
        return float(self._servo[0]), float(self._servo[1])

    @property
    def output(self) -> float:
        """Angle of the motor behind the gear's play [rad]: that of the linkage."""
        return float(self._servo[_BEHIND_PLAY if len(self._servo) > _BEHIND_PLAY else 0])

    @property
    def wheels(self) -> tuple[float, float]:
        """Angles of the left and the right steered wheel about their king-pins [rad]."""
        left, right, *_ = self._functions.wheel_angles(self.output, self._constants)
        return float(left), float(right)

    def advance(self, setpoint: float | None) -> None:
        """Move on by a tick.

        Parameters
        ----------
        setpoint : float or None
            Set-point of the motor angle [rad]; None: the gear holds the angle.
        """
        setpoints = np.array([math.nan if setpoint is None else setpoint])
        self._functions.steer(self._servo, setpoints, self._constants, 2, self._table, self._angles)


class Motor:
    """The motor with its limits and its lag, at rest.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with the motor's law and constants.

    Attributes
    ----------
    torque : float
        Torque of the motor [N m].
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self._law, self._group = motor_law(vehicle)
        self._lag = vehicle.motor_lag
        self.torque = 0.0

    def advance(self, wanted: float, spin: float) -> None:
        """Advance by a tick.

        Parameters
        ----------
        wanted : float
            Demanded torque [N m].
        spin : float
            Spin of the motor [rad/s].
        """
        slope, *_ = self._law(self._group, 0, spin, self.torque, 0.0, 0.0, wanted)
        self.torque += float(slope) * self._lag * -math.expm1(-TICK / self._lag)
