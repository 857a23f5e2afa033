"""A load on the vehicle: mass, centre of mass and inertia of both together."""

import dataclasses
from dataclasses import dataclass

from tricycle_sim.vehicle.constants import Vehicle


@dataclass(frozen=True)
class Payload:
    """A point mass fixed to the body.

    Attributes
    ----------
    mass : float
        Mass [kg].
    x, y : float
        Position in front of the empty vehicle's centre of mass and to its left [m].
    z : float
        Height above the road with unloaded tyres [m].
    """

    mass: float
    x: float = 0.0
    y: float = 0.0
    z: float = 0.6


def with_payload(vehicle: Vehicle, payload: Payload) -> Vehicle:
    """Return a vehicle that carries a load.

    The body frame moves to the common centre of mass. Products of inertia, which the model does not
    have, are left out. Where `load_sensitivity` is not 0, the tyres' stiffness refers to the loaded
    vehicle's mean load as before to the empty one's.

    Parameters
    ----------
    vehicle : Vehicle
        Empty vehicle; the range of an unknown constant that the load changes moves with its nominal
        value.
    payload : Payload
        Mass and position of the load.

    Raises
    ------
    VehicleError
        If a constant leaves its range, as with a load outside the wheels.
    """
    total = vehicle.mass + payload.mass
    share = payload.mass / total
    x, y, z = payload.x, payload.y, payload.z - vehicle.com_height
    reduced = vehicle.mass * share  # of two bodies about their common centre of mass
    yaw = reduced * (x * x + y * y)
    moved = {
        entry: value - factor * share * by
        for wheel in vehicle.wheels
        for name, by in (("x", x), ("y", y))
        for entry, factor in wheel.spellings(name)
        if (value := vehicle.values.get(entry)) is not None
    }
    values = {
        "mass": total,
        "roll_inertia": vehicle.roll_inertia + reduced * (y * y + z * z),
        "pitch_inertia": vehicle.pitch_inertia + reduced * (x * x + z * z),
        "yaw_inertia": vehicle.yaw_inertia + yaw,
        "com_height": vehicle.com_height + share * z,
        **moved,
    }
    changes = {name: values.get(name, old) - old for name, old in vehicle.nominal.items()}
    unknown = {
        name: (low + changes[name], high + changes[name])
        for name, (low, high) in vehicle.unknown.items()
    }
    return dataclasses.replace(vehicle, values={**vehicle.values, **values}, unknown=unknown)
