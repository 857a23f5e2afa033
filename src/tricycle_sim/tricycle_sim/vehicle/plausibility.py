"""What is physically impossible or doubtful about a vehicle whose constants are each in bounds."""

import math
from collections.abc import Iterator

from tricycle_sim.vehicle.constants import Vehicle


def warnings_about(vehicle: Vehicle) -> tuple[str, ...]:
    """Return what is physically impossible or doubtful about a vehicle, a line each.

    Parameters
    ----------
    vehicle : Vehicle
        With each constant in its bounds.
    """
    return (*_inertia(vehicle), *_loads(vehicle), *_stability(vehicle))


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
    for wheel, load in zip(("left", "right", "rear"), vehicle.static_loads(), strict=True):
        if load <= 0:
            yield f"{wheel} wheel: carries {load:.1f} N at rest: the vehicle tips over"
        if load / vehicle.vertical_stiffness > 0.1 * vehicle.tyre_radius:
            yield f"vertical_stiffness: the {wheel} tyre sinks by more than a tenth of its radius"


def _stability(vehicle: Vehicle) -> Iterator[str]:
    """Warn of the unstable linear bicycle: see docs/model.md."""
    wheelbase = vehicle.com_to_front_axle + vehicle.com_to_rear_axle
    lowest = min(vehicle.unknown.get("cornering_stiffness", (vehicle.cornering_stiffness,)))
    understeer = vehicle.com_to_rear_axle * lowest - vehicle.com_to_front_axle * 2 * lowest
    if understeer < 0:
        critical = math.sqrt(2 * lowest**2 * wheelbase**2 / (-understeer * vehicle.mass))
        top = vehicle.motor_no_load_speed * vehicle.tyre_radius
        if critical < top:
            yield (
                f"cornering_stiffness: at {lowest:g} N/rad the vehicle oversteers and is unstable "
                f"from {critical:.1f} m/s, below its top speed of {top:.1f} m/s"
            )
