"""The speed controller with a speed that is not the wheel's: what a broken sensor does to it."""

from typing import Any

import numpy as np

from tricycle_core.timing import TICK
from tricycle_sim.vehicle.actuators import MOTORS
from tricycle_sim.vehicle.constants import Vehicle
from tricycle_sim.vehicle.layout import LANES
from tricycle_sim.vehicle.parts import Laws, law_names


class SpeedLoop:
    """The vehicle's speed controller at ticks of 10 ms; it starts at the torque that there is.

    Parameters
    ----------
    vehicle : Vehicle
        With the controller's gains and the motor's limits.
    torque : float
        Of the motor now [N m].
    setpoint, speed : float
        Now [m/s].
    """

    def __init__(self, vehicle: Vehicle, torque: float, setpoint: float, speed: float) -> None:
        function, formulas = MOTORS[law_names(vehicle)[Laws._fields.index("motor")]]
        self._law: Any = getattr(function, "py_func", function)  # once a tick: not compiled
        self._group = np.repeat([float(formula(vehicle)) for formula in formulas.values()], LANES)
        self._radius = vehicle.tyre_radius
        self._lag = vehicle.motor_lag
        error = (setpoint - speed) / self._radius
        wanted = torque - vehicle.speed_gain_proportional * error
        gain = vehicle.speed_gain_integral
        self._integrator = wanted / gain if gain else 0.0

    def torque(self, setpoint: float, speed: float) -> float:
        """Return the torque for the next tick [N m].

        Parameters
        ----------
        setpoint : float
            Of the speed [m/s].
        speed : float
            As it is measured [m/s].
        """
        torque_slope, integrator_slope, _ = self._law(
            self._group, 0, speed / self._radius, 0.0, self._integrator, 1.0, setpoint
        )
        self._integrator += TICK * integrator_slope
        return float(torque_slope * self._lag)
