"""The interface of what the boards drive, and the state of a plant that moves in the plane."""

import math
from typing import NamedTuple, Protocol, runtime_checkable

from tricycle_core.poses import Pose
from tricycle_core.timing import TICK
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.live import LiveState


class Plant(Protocol):
    """A vehicle between the boards' actuators and sensors, at ticks of 10 ms.

    A class of plants is called with a `Vehicle` and a seed (int) of whatever is random in it. It
    may be slow: simulated time waits for it.
    """

    def place(self, start: Pose) -> LiveState:
        """Return the state at rest at a pose.

        Parameters
        ----------
        start : (float, float, float)
            Pose of the COM: x, y [m] and heading [rad].
        """
        ...

    def advance(self, tick: int, steering: float | None, torque: float, brake: float) -> LiveState:
        """Return the state after a tick.

        Parameters
        ----------
        tick : int
            Number of ticks so far; placing the plant anew does not reset it.
        steering : float or None
            Set-point of the steering servo [rad]; None: no pulses, the gear holds the angle.
        torque : float
            Torque wanted of the motor [N m].
        brake : float
            Share of the friction brake, 0 to 1.
        """
        ...

    def close(self) -> None:
        """Free what the plant holds."""


@runtime_checkable
class HoldsSpeed(Plant, Protocol):
    """A plant with the emulated drive board's speed controller inside of its own equations."""

    def hold_speed(
        self, tick: int, steering: float | None, speed: float, brake: float
    ) -> LiveState:
        """Return the state after a tick with a speed set-point instead of a torque.

        Parameters
        ----------
        tick, steering, brake : int, float or None, float
            Arguments of `Plant.advance`.
        speed : float
            Speed set-point of the driven wheels' tread [m/s].
        """
        ...


class PlanarMotion(NamedTuple):
    """How a vehicle moves in the plane: its COM, in the body frame.

    Attributes
    ----------
    vx, vy : float
        Velocity, forward and to the left [m/s].
    yaw_rate : float
        Rate of the heading [rad/s].
    ax, ay : float
        Readings of an accelerometer, forward and to the left [m/s^2].
    """

    vx: float
    vy: float
    yaw_rate: float
    ax: float
    ay: float


def planar_state(
    vehicle: Vehicle,
    tick: int,
    pose: Pose,
    motion: PlanarMotion,
    *,
    steering: tuple[float, float],
    wheel: tuple[float, float],
    torque: float = 0.0,
) -> LiveState:
    """Return the state of a plant that stays upright.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with the constants that planar motion lacks: height, gravity, battery.
    tick : int
        Number of ticks so far.
    pose : (float, float, float)
        x, y [m] of the COM and heading [rad].
    motion : PlanarMotion
        Velocities and accelerations.
    steering : (float, float)
        Angle and rate of the steering motor [rad, rad/s].
    wheel : (float, float)
        Angle since the start and rate of the motor of the driven wheels [rad, rad/s].
    torque : float
        Torque of the motor of the driven wheels [N m].
    """
    x, y, yaw = pose
    angle, rate = wheel
    power = torque * rate + vehicle.motor_copper_loss * torque**2
    return LiveState(
        time=tick * TICK,
        x=x,
        y=y,
        z=vehicle.com_height,
        quaternion=(math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)),
        roll=0.0,
        pitch=0.0,
        yaw=math.remainder(yaw, math.tau),
        vx=motion.vx,
        vy=motion.vy,
        vz=0.0,
        roll_rate=0.0,
        pitch_rate=0.0,
        yaw_rate=motion.yaw_rate,
        specific_force=(motion.ax, motion.ay, vehicle.gravity),
        wheel_speeds=len(vehicle.wheels) * (rate,),
        drive_speed=rate,
        drive_angle=angle,
        steering_motor_angle=steering[0],
        steering_motor_rate=steering[1],
        loads=vehicle.static_loads(),
        motor_torque=torque,
        motor_power=power,
        motor_current=power / vehicle.battery_voltage,
        rolled_over=False,
    )
