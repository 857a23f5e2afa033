"""The speed controller with a speed that is not the wheel's: what a broken sensor does to it."""

from typing import Any

import numpy as np

from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.vehicle.constants import Vehicle
from tricycle_sim.vehicle.layout import LANES
from tricycle_sim.vehicle.registry import PARTS, law_name


def motor_law(vehicle: Vehicle) -> tuple[Any, FloatArray]:
    """Return the law of a motor, to be called once a tick, and the group of its constants.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with its motor.
    """
    law = PARTS["motor"][law_name("motor", vehicle.wheels, vehicle.parts)]
    driven = vehicle.of(next(wheel for wheel in vehicle.wheels if wheel.driven))
    return law.function, np.repeat([float(row(driven)) for row in law.rows.values()], LANES)


class SpeedLoop:
    """The vehicle's speed controller at ticks of 10 ms; it starts at the present torque.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with the controller's gains and the motor's limits.
    torque : float
        Present torque of the motor [N m].
    setpoint, speed : float
        Present set-point and measured speed [m/s].
    """

    def __init__(self, vehicle: Vehicle, torque: float, setpoint: float, speed: float) -> None:
        self._law, self._group = motor_law(vehicle)
        self._radius = vehicle.driven_radius
        self._lag = vehicle.motor_lag
        self._integrator = 0.0
        if vehicle.has_speed_loop and vehicle.speed_gain_integral:
            scale = vehicle.values.get("speed_scale", 1.0)  # as in the motor's law
            error = (scale * setpoint - speed) / self._radius
            wanted = torque - vehicle.speed_gain_proportional * error
            self._integrator = wanted / vehicle.speed_gain_integral

    def torque(self, setpoint: float, speed: float) -> float:
        """Return the torque for the next tick [N m].

        Parameters
        ----------
        setpoint : float
            Speed set-point [m/s].
        speed : float
            Measured speed [m/s].
        """
        torque_slope, integrator_slope, _ = self._law(
            self._group, 0, speed / self._radius, 0.0, self._integrator, 1.0, setpoint
        )
        self._integrator += TICK * integrator_slope
        return float(torque_slope * self._lag)
