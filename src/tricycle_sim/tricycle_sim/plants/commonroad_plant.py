"""CommonRoad's multi-body car as a plant: a BMW 320i with suspension and Pacejka's tyres.

M. Althoff, G. Würsching: CommonRoad: Vehicle Models, of the package `commonroad-vehicle-models`.
Steered by rate and driven by acceleration, as its authors do. Their equations are singular at
standstill; under `SLOW` their kinematic single-track model takes their place. It never rolls back.
"""

import math
from typing import Any

import numpy as np
from scipy.integrate import odeint

from tricycle_core.errors import PlantError
from tricycle_core.optional import missing
from tricycle_core.poses import Pose
from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.plants.actuators import Motor, SteeringServo
from tricycle_sim.plants.plant import PlanarMotion, planar_state
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.live import LiveState

try:
    from vehiclemodels.init_mb import init_mb
    from vehiclemodels.parameters_vehicle2 import parameters_vehicle2
    from vehiclemodels.utils.vehicle_dynamics_ks_cog import vehicle_dynamics_ks_cog
    from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb
except ModuleNotFoundError as error:
    raise PlantError(missing("vehiclemodels", "the plant commonroad")) from error

SLOW = 0.5
"""Speed [m/s] under which it rolls without slip; once faster, until it is at four fifths of it."""
SCALE = 20.0
"""Forces and masses of the car by those of the file and the boards, whose motor is a hub's."""
CLOSE = 0.02  # share by which the vehicle file may differ from the car in what the boards know
KINEMATIC = 5  # states of the kinematic model, the first of the multi-body model too
# numbers of states of the multi-body model
ANGLE, SPEED, YAW, YAW_RATE, LATERAL_SPEED, REAR_LEFT, REAR_RIGHT = 2, 3, 4, 5, 10, 25, 26


class MultiBodyPlant:
    """The BMW 320i.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle as boards and planner know it: `bmw_320i.yaml` beside this module, or like it.
        Servo, linkage, motor and brake are the file's; they make the rate and the acceleration.
    seed : int
        Not used: nothing is random.

    Raises
    ------
    PlantError
        If the vehicle is quite another one.
    """

    def __init__(self, vehicle: Vehicle, seed: int = 0) -> None:  # noqa: ARG002 (of every plant)
        self._vehicle = vehicle
        self._car: Any = parameters_vehicle2()
        car = self._car
        for name, value, own in (
            ("tyre_radius", car.R_w, vehicle.driven_radius),
            ("mass", car.m / SCALE, vehicle.mass),
            ("wheelbase", car.a + car.b, vehicle.wheelbase),
        ):
            if abs(own / value - 1.0) > CLOSE:
                raise PlantError(
                    f"{vehicle.name}: {name}: {own:g} must be about {value:g}, as in bmw_320i.yaml"
                )
        self.place((0.0, 0.0, 0.0))

    def place(self, start: Pose) -> LiveState:
        """Return the state at rest at a pose.

        Parameters
        ----------
        start : (float, float, float)
            x, y [m] and heading [rad].
        """
        x, y, heading = start
        self._x = np.array([x, y, 0.0, 0.0, heading])
        self._servo, self._motor = SteeringServo(self._vehicle), Motor(self._vehicle)
        self._turned = 0.0
        return self._state(0, 0.0, 0.0)

    def advance(self, tick: int, steering: float | None, torque: float, brake: float) -> LiveState:
        """Return the state after a tick.

        Parameters
        ----------
        tick, steering, torque, brake : int, float or None, float, float
            Arguments of `Plant.advance`.
        """
        vehicle, car, x = self._vehicle, self._car, self._x
        before = self._spin()
        self._servo.advance(steering)
        self._motor.advance(torque, before)
        left, right = map(math.tan, self._servo.wheels)
        both = left + right
        angle = math.atan(2.0 * left * right / both) if both else 0.0  # of one wheel in the middle
        rate = (angle - x[ANGLE]) / TICK
        braking = brake * vehicle.brake_torque
        drive = SCALE * (self._motor.torque - braking) / (car.R_w * car.m)
        if len(x) == KINEMATIC:
            drive = max(drive, -x[SPEED] / TICK)
        self._x = self._moved(rate, drive)
        if len(self._x) == KINEMATIC and self._x[SPEED] > SLOW:
            self._x = np.array(init_mb(self._rolling(), car), dtype=float)
        elif len(self._x) > KINEMATIC and self._x[SPEED] < 0.8 * SLOW:
            self._x = self._x[:KINEMATIC]
        self._turned += 0.5 * TICK * (before + self._spin())
        return self._state(tick + 1, rate, drive)

    def close(self) -> None:
        """Do nothing."""

    def _moved(self, rate: float, acceleration: float) -> FloatArray:
        model: Any = vehicle_dynamics_ks_cog if len(self._x) == KINEMATIC else vehicle_dynamics_mb
        inputs = [rate, acceleration]

        def slopes(x: FloatArray, _: float) -> Any:
            return model(x.tolist(), inputs, self._car)

        moved: FloatArray = odeint(slopes, self._x, [0.0, TICK], rtol=1e-6, atol=1e-8)[-1]
        return moved

    def _rolling(self) -> list[float]:
        """Core states of the kinematic model with yaw rate and slip angle."""
        x, car = self._x, self._car
        slip = math.atan(math.tan(x[ANGLE]) * car.b / (car.a + car.b))
        turn = x[SPEED] * math.cos(slip) * math.tan(x[ANGLE]) / (car.a + car.b)
        return [*x.tolist(), turn, slip]

    def _spin(self) -> float:
        """Return the mean rate of the driven wheels, behind [rad/s]."""
        if len(self._x) > KINEMATIC:
            return float(0.5 * (self._x[REAR_LEFT] + self._x[REAR_RIGHT]))
        *_, slip = self._rolling()
        return float(self._x[SPEED] * math.cos(slip) / self._car.R_w)

    def _state(self, tick: int, rate: float, acceleration: float) -> LiveState:
        x = self._x
        if len(x) == KINEMATIC:
            *_, turn, slip = self._rolling()
            vx, vy = x[SPEED] * math.cos(slip), x[SPEED] * math.sin(slip)
            forward, aside = acceleration, turn * x[SPEED]
        else:
            vx, vy, turn = x[SPEED], x[LATERAL_SPEED], x[YAW_RATE]
            slopes = vehicle_dynamics_mb(x.tolist(), [rate, acceleration], self._car)
            forward, aside = slopes[SPEED] - turn * vy, slopes[LATERAL_SPEED] + turn * vx
        motion = PlanarMotion(*map(float, (vx, vy, turn, forward, aside)))
        return planar_state(
            self._vehicle,
            tick,
            (float(x[0]), float(x[1]), float(x[YAW])),
            motion,
            steering=self._servo.motor,
            wheel=(self._turned, self._spin()),
            torque=self._motor.torque,
        )
