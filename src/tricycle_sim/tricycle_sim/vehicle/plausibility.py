"""Impossible or doubtful combinations of a vehicle's constants, each of them within its bounds."""

import math
from collections.abc import Iterator

from tricycle_core.errors import VehicleError
from tricycle_core.timing import TICK
from tricycle_sim.vehicle.constants import Vehicle


def warnings_about(vehicle: Vehicle) -> tuple[str, ...]:
    """Return what is physically impossible or doubtful about a vehicle, a line each.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle whose constants are each within their bounds.
    """
    return (
        *_inertia(vehicle),
        *_loads(vehicle),
        *_motor(vehicle),
        *_stability(vehicle),
        *_steps(vehicle),
    )


def _inertia(vehicle: Vehicle) -> Iterator[str]:
    names = ("roll_inertia", "pitch_inertia", "yaw_inertia")
    inertia = {name: getattr(vehicle, name) for name in names}
    for name, value in inertia.items():
        others = sum(inertia.values()) - value
        if value > others:
            yield (
                f"{name}: {value:g} kg m^2 is larger than the sum of the other two, {others:g}: "
                "no rigid body has such inertia"
            )
    if "yaw_inertia" in vehicle.unknown:
        high = vehicle.unknown["yaw_inertia"][1]
        limit = vehicle.roll_inertia + vehicle.pitch_inertia
        if high > limit:
            yield (
                f"yaw_inertia.range: up to {high:g} kg m^2, but a rigid body needs at most "
                f"roll_inertia + pitch_inertia = {limit:g}"
            )


def _loads(vehicle: Vehicle) -> Iterator[str]:
    for wheel, load in zip(vehicle.wheels, vehicle.static_loads(), strict=True):
        name, own = wheel.name, vehicle.of(wheel)
        if load <= 0:
            yield f"{name} wheel: carries {load:.1f} N at rest: the vehicle tips over"
        if load / own.vertical_stiffness > 0.1 * own.tyre_radius:
            yield f"vertical_stiffness: the {name} tyre sinks by more than a tenth of its radius"


def _motor(vehicle: Vehicle) -> Iterator[str]:
    for name, torque in vehicle.values.items():
        if name.startswith("throttle_torque_") and torque > vehicle.motor_torque:
            yield f"{name}: {torque:g} N m is more than motor_torque, {vehicle.motor_torque:g}"


def _stability(vehicle: Vehicle) -> Iterator[str]:
    """Warn of the unstable linear bicycle: see docs/model.md."""
    # of both axles: ranges that were guessed hold all sorts of ratios between them
    lowest = {
        name: limits[0]
        for name, limits in vehicle.unknown.items()
        if name.rpartition(".")[2] == "cornering_stiffness"
    }
    front, rear = vehicle.replace(**lowest).axle_stiffness().values()
    understeer = vehicle.com_to_rear_axle * rear - vehicle.com_to_front_axle * front
    if understeer < 0 < min(front, rear) and "motor_no_load_speed" in vehicle.values:
        critical = math.sqrt(front * rear * vehicle.wheelbase**2 / (-understeer * vehicle.mass))
        top = vehicle.motor_no_load_speed * vehicle.driven_radius
        if critical < top:
            yield (
                f"cornering_stiffness: at {front:g} N/rad in front and {rear:g} N/rad behind the "
                f"vehicle oversteers and is unstable from {critical:.1f} m/s, below its top speed "
                f"of {top:.1f} m/s"
            )


def _steps(vehicle: Vehicle) -> Iterator[str]:
    """Warn of ranges that hold vehicles whose simulation explodes."""
    # slow to import; loading a vehicle does not need it
    from tricycle_sim.vehicle.stability import check_step

    for name, ends in vehicle.unknown.items():
        for end in ends:
            try:
                check_step(vehicle.replace(**{name: end}), TICK)
            except VehicleError as error:
                yield f"{name}.range: with {end:g} {vehicle.unit(name)} {error}"
