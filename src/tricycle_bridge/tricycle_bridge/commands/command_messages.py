"""From a commander's message to a command of the vehicle, or what is wrong with the message."""

from __future__ import annotations

import math
from collections.abc import Sequence

from tricycle_bridge.commands.command_stream import VehicleCommand
from tricycle_bridge.commands.kinematics import TurningGeometry
from tricycle_bridge.protocol.units import ANGLE_UNIT, SPEED_UNIT
from tricycle_bridge.settings import BridgeSettings
from tricycle_core.errors import LinkError
from tricycle_core.joints import JOINTS, REAR_WHEEL_JOINT, STEERING_JOINT


def joint_command(
    names: Sequence[str],
    positions: Sequence[float],
    velocities: Sequence[float],
    tyre_radius: float,
) -> VehicleCommand:
    """Return the command in a JointState.

    Parameters
    ----------
    names : sequence of str
        Names of the joints; others than the two are ignored.
    positions, velocities : sequence of float
        Position [rad] and velocity [rad/s] of each joint.
    tyre_radius : float
        Radius of the rear wheel [m].

    Raises
    ------
    LinkError
        If a joint or its value is missing, stands there twice, or is not finite.
    """
    names = list(names)
    for joint in JOINTS:
        if names.count(joint) > 1:
            raise LinkError(f"{joint} is there {names.count(joint)} times, must be once")
    try:
        angle = positions[names.index(STEERING_JOINT)]
        wheel_rate = velocities[names.index(REAR_WHEEL_JOINT)]
    except (ValueError, IndexError):
        raise LinkError(
            f"must give position and velocity of {STEERING_JOINT} and {REAR_WHEEL_JOINT}"
        ) from None
    return VehicleCommand(angle, wheel_rate * tyre_radius)


def twist_command(
    speed: float,
    wanted: float,
    settings: BridgeSettings,
    geometry: TurningGeometry,
    *,
    resting_angle: float,
) -> VehicleCommand:
    """Return the command in a Twist.

    Parameters
    ----------
    speed : float
        Speed [m/s], forward positive.
    wanted : float
        Commanded turn rate [rad/s], left positive.
    settings : BridgeSettings
        Settings of the bridge, among them the largest steering angle.
    geometry : TurningGeometry
        Relation of steering angle and curvature.
    resting_angle : float
        Angle of the steering motor at speed 0 [rad].

    Raises
    ------
    LinkError
        If a value is not finite, or the steering cannot give the turn rate.
    """
    for name, value in (("speed", speed), ("turn rate", wanted)):
        if not math.isfinite(value):
            raise LinkError(f"{name} is {value}: must be a finite number")
    side = math.copysign(settings.max_steering_angle, speed * wanted)
    largest = abs(geometry.turn_rate(speed, side))
    if abs(wanted) > largest * (1.0 + 1e-6):
        raise LinkError(
            f"turn rate {wanted:.4g} rad/s at {speed:.4g} m/s: "
            f"the steering gives {largest:.4g} rad/s at most"
        )
    if speed == 0.0:
        return VehicleCommand(resting_angle, 0.0)
    return VehicleCommand(geometry.motor_angle(speed, wanted), speed)


def limit_refusal(command: VehicleCommand, settings: BridgeSettings) -> str | None:
    """Return which limit a command exceeds by more than rounding; None if it exceeds none.

    Parameters
    ----------
    command : VehicleCommand
        Command to check.
    settings : BridgeSettings
        Settings of the bridge, with the limits.
    """
    angle, speed = command.steering_motor_angle, command.speed
    if abs(angle) > settings.max_steering_angle + ANGLE_UNIT:
        return f"steering angle {angle:.4g} rad: at most {settings.max_steering_angle:.4g} rad"
    if abs(speed) > settings.max_speed + SPEED_UNIT:
        return f"speed {speed:.4g} m/s: at most {settings.max_speed:.4g} m/s"
    return None
