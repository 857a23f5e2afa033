"""The plants of all installed distributions, by name."""

from importlib.metadata import entry_points
from inspect import signature
from pathlib import Path
from typing import Any

from tricycle_core.errors import ExcitationError, PlantError, hint, message_of
from tricycle_sim.plants import OWN
from tricycle_sim.plants.own import OwnPlant
from tricycle_sim.plants.plant import Plant
from tricycle_sim.vehicle import Vehicle

ENTRY_POINTS = "tricycle_sim.plants"
"""Group of entry points under which a distribution registers classes of plants by name."""


def plant_names() -> tuple[str, ...]:
    """Return the names of all plants, our own first."""
    return OWN, *sorted(entry_points(group=ENTRY_POINTS).names)


def check_plant(name: str) -> None:
    """Refuse a plant that is not installed.

    Parameters
    ----------
    name : str
        As for `plant_by_name`.

    Raises
    ------
    PlantError
        If the name is unknown; the message lists the known ones.
    """
    known = plant_names()
    if name.partition(":")[0] not in known:
        raise PlantError(f"unknown plant {name!r}; {hint(name, known)}")


def plant_by_name(name: str, vehicle: Vehicle, seed: int = 0) -> Plant:
    """Return a plant.

    Parameters
    ----------
    name : str
        One of `plant_names`; `NAME:FILE` gives a plant a file of its own, as `fmu:car.yaml`.
    vehicle : Vehicle
        Vehicle with its true values.
    seed : int
        Seed of whatever is random in the plant.

    Raises
    ------
    PlantError
        If the name is unknown, or the plant cannot be made; the message says which are known, or
        why.
    """
    name, _, file = name.partition(":")
    if name == OWN:
        if file:
            raise PlantError(f"the plant {OWN} takes no file: the vehicle file is its own")
        return OwnPlant(vehicle, seed)
    check_plant(name)
    # a colcon workspace over an installed wheel registers the same class twice
    points = {point.value: point for point in entry_points(group=ENTRY_POINTS, name=name)}
    if len(points) > 1:
        raise PlantError(f"plant {name!r} is registered for {' and for '.join(sorted(points))}")
    ((value, point),) = points.items()
    more = (Path(file),) if file else ()
    try:
        make = point.load()
        _check_call(name, make, vehicle, seed, *more)
        plant: Plant = make(vehicle, seed, *more)
    except ExcitationError:
        raise
    except OSError as error:  # of its file
        raise PlantError(f"plant {name!r}: {message_of(error)}") from error
    except Exception as error:  # whatever an installed package may raise
        raise PlantError(f"plant {name!r} cannot be made of {value}: {error!r}") from error
    return plant


def _check_call(name: str, make: Any, *arguments: object) -> None:
    """Refuse a file for a plant that takes none."""
    try:
        signature(make).bind(*arguments)
    except TypeError:
        *_, last = arguments
        if not isinstance(last, Path):
            raise
        raise PlantError(f"the plant {name} takes no file, but {last} is given") from None
    except ValueError:  # it has no signature
        return
