"""The unknown parameters of a vehicle: checks of names, and restriction to some."""

import dataclasses
from collections.abc import Iterable, Sequence

from tricycle_core.errors import IdentificationError
from tricycle_sim.vehicle import Vehicle


def check_unknown(vehicle: Vehicle, names: Iterable[str]) -> None:
    """Refuse names that are none of a vehicle's unknown parameters.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle that has the unknown parameters.
    names : iterable of str
        Names to be checked.

    Raises
    ------
    IdentificationError
        If one is not unknown; the message lists those that are.
    """
    for name in names:
        if name not in vehicle.unknown:
            raise IdentificationError(
                f"{name!r} is not an unknown parameter of {vehicle.name}; there are: "
                f"{', '.join(vehicle.unknown) or 'none'}"
            )


def restrict(vehicle: Vehicle, parameters: Sequence[str]) -> Vehicle:
    """Return the vehicle with only these parameters unknown, the others at their nominal values.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle in which at least these parameters are unknown.
    parameters : sequence of str
        Names of the parameters that stay unknown.

    Raises
    ------
    IdentificationError
        If one is not unknown, or none is left.
    """
    if isinstance(parameters, str):  # a sequence, too: of letters
        raise IdentificationError(f"parameters: a list of names is needed, as [{parameters!r}]")
    check_unknown(vehicle, parameters)
    if not parameters:
        raise IdentificationError(f"{vehicle.name}: no unknown parameter: nothing to identify")
    unknown = {name: vehicle.unknown[name] for name in vehicle.unknown if name in parameters}
    return dataclasses.replace(vehicle, unknown=unknown)
