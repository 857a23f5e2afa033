"""Vehicle files: wheels, laws and constants of a vehicle as documented YAML, validated on load.

In the file each number stands with its unit, what it rests on (data, argued, literature,
interpreted) and why.
"""

import enum
import math
import re
import reprlib
from collections.abc import Mapping
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from tricycle_core.documents import parse_yaml, read_bounded
from tricycle_core.errors import VehicleError, hint
from tricycle_sim.vehicle.constants import (
    Vehicle,
    check_entry,
    check_read,
    constant_entries,
)
from tricycle_sim.vehicle.laws import Constant
from tricycle_sim.vehicle.parts import check_steering
from tricycle_sim.vehicle.wheels import TADPOLE, Wheel

MAX_BYTES = 1_000_000  # of a vehicle file
KEYS = ("name", "about", "wheels", "parts", "constants")
ENTRY_KEYS = ("value", "nominal", "range", "unit", "basis", "about")


class Basis(enum.Enum):
    """Basis of a number in the vehicle file."""

    DATA = "data"  # measured or published for this vehicle
    ARGUED = "argued"  # our choice, with its reason
    LITERATURE = "literature"  # typical value from the literature
    INTERPRETED = "interpreted"  # the source is silent or contradictory; this is our reading


def load_vehicle(path: Path | None = None) -> Vehicle:
    """Read a vehicle file.

    Parameters
    ----------
    path : Path, optional
        YAML file; by default the tricycle that comes with the package.

    Raises
    ------
    VehicleError
        One line that names file and entry, if the file is not a complete and valid vehicle.
    OSError
        If the file cannot be read.
    """
    if path is None:
        return _packaged()
    return _parse(vehicle_document(path), str(path))


def parse_vehicle(content: bytes, where: str) -> Vehicle:
    """Return the vehicle that the content of a file describes.

    Parameters
    ----------
    content : bytes
        Content of a vehicle file.
    where : str
        Named first in the message, usually the file.

    Raises
    ------
    VehicleError
        One line that names `where` and the entry, if it is not a complete and valid vehicle.
    """
    return _parse(parse_yaml(content, where, VehicleError), where)


def vehicle_document(path: Path | None = None) -> Any:
    """Return what a vehicle file holds, not validated, to write another one from it.

    Parameters
    ----------
    path : Path, optional
        YAML file; by default the tricycle that comes with the package.

    Raises
    ------
    VehicleError
        If the file is no YAML.
    OSError
        If the file cannot be read.
    """
    packaged = Path(str(resources.files("tricycle_sim")))
    if path is None:
        path = packaged / "tricycle.yaml"
    elif not path.exists() and (packaged / f"{path.stem}.yaml").exists():
        raise VehicleError(f"{path}: no such file; is {packaged / f'{path.stem}.yaml'} meant?")
    return parse_yaml(
        read_bounded(path, MAX_BYTES, "a vehicle file", VehicleError), str(path), VehicleError
    )


@cache
def _packaged() -> Vehicle:
    return _parse(vehicle_document(), "tricycle.yaml")


def _parse(document: Any, where: str) -> Vehicle:
    if isinstance(document, dict):
        _check_keys(f"{where}: ", document, KEYS, "a vehicle file")
    if not isinstance(document, dict) or not isinstance(document.get("constants"), dict):
        raise VehicleError(f"{where}: needs the keys 'name' and 'constants' (entries by name)")
    title = document.get("name")
    if not isinstance(title, str) or not title or not title.isprintable():
        raise VehicleError(f"{where}: name: needs a text of one line")
    parts = document.get("parts", {})
    if not isinstance(parts, dict) or not all(isinstance(n, str) for i in parts.items() for n in i):
        raise VehicleError(f"{where}: parts: needs names of laws by part")
    if "linkage" in parts:  # the part's name in older files
        parts = {("steering" if part == "linkage" else part): law for part, law in parts.items()}
    values: dict[str, float] = {}
    unknown: dict[str, tuple[float, float]] = {}
    try:
        wheels = _parse_wheels(document["wheels"]) if "wheels" in document else TADPOLE
        constants = constant_entries(wheels, parts)
        for name, entry in document["constants"].items():
            values[name], limits = _parse_entry(name, constants, entry)
            if limits is not None:
                unknown[name] = limits
        vehicle = Vehicle(name=title, values=values, unknown=unknown, parts=parts, wheels=wheels)
        check_read(wheels, parts, values)
        check_steering(vehicle)
    except VehicleError as error:
        raise VehicleError(f"{where}: {error}") from error
    return vehicle


def _parse_wheels(entries: object) -> tuple[Wheel, ...]:
    if not isinstance(entries, list):
        raise VehicleError("wheels: needs a list of three or four")
    wheels = []
    for number, entry in enumerate(entries, start=1):
        if not isinstance(entry, dict) or not {"name", "axle"} <= set(entry):
            raise VehicleError(f"wheels: number {number} needs a name and an axle")
        roles = ("steered", "driven", "braked")
        _check_keys(f"wheels: {entry['name']}.", entry, ("name", "axle", *roles), "a wheel")
        for key, value in entry.items():
            if key in roles and not isinstance(value, bool):
                raise VehicleError(f"wheels: {entry['name']}.{key}: needs true or false")
            if key not in roles and not isinstance(value, str):
                raise VehicleError(f"wheels: number {number}: {key}: needs a text")
        wheels.append(Wheel(**entry))
    return tuple(wheels)


def _parse_entry(
    name: object, constants: Mapping[str, Constant], entry: object
) -> tuple[float, tuple[float, float] | None]:
    """Return the value of an entry and, of an unknown parameter, its range."""
    name = str(name)
    check_entry(name, constants)
    unit = constants[name].unit
    if not isinstance(entry, dict):
        raise VehicleError(f"{name}: needs value (or nominal and range), unit, basis and about")
    _check_keys(f"{name}.", entry, ENTRY_KEYS, "a constant")
    scale = 1.0
    if unit == "rad" and entry.get("unit") == "deg":
        scale = math.pi / 180.0
    elif entry.get("unit") != unit:
        found = f", not {reprlib.repr(entry['unit'])}" if "unit" in entry else ""
        raise VehicleError(f"{name}.unit: needs '{unit}'{found}")
    bases = [basis.value for basis in Basis]
    if entry.get("basis") not in bases:
        raise VehicleError(f"{name}.basis: needs one of {', '.join(bases)}")
    if not isinstance(entry.get("about"), str):
        raise VehicleError(f"{name}.about: needs a text that says where the number comes from")
    if "range" in entry or "nominal" in entry:
        limits = entry.get("range")
        if "value" in entry or not isinstance(limits, list) or len(limits) != 2:
            raise VehicleError(f"{name}: needs either value, or nominal and range: [low, high]")
        low, high = (scale * _number(f"{name}.range", item) for item in limits)
        return scale * _number(f"{name}.nominal", entry.get("nominal")), (low, high)
    return scale * _number(f"{name}.value", entry.get("value")), None


def _number(where: str, value: object) -> float:
    if value is None:
        raise VehicleError(f"{where}: is missing")
    if isinstance(value, bool) or not isinstance(value, int | float):
        hint = ""
        if isinstance(value, str) and re.fullmatch(r"[-+]?[\d.]+[eE][-+]?\d+", value):
            hint = " (YAML wants 5.0e-4 for 5e-4, 5.0e+4 for 5e4)"
        raise VehicleError(f"{where}: needs a number, not {reprlib.repr(value)}{hint}")
    try:
        return float(value)
    except OverflowError:  # an integer
        raise VehicleError(f"{where}: is too large a number") from None


def _check_keys(
    place: str, entries: Mapping[Any, object], keys: tuple[str, ...], what: str
) -> None:
    for key in entries:
        if key not in keys:
            # YAML reads {value: 48,3} as {value: 48, 3: null}
            remedy = "numbers need a decimal point" if isinstance(key, int) else hint(key, keys)
            raise VehicleError(f"{place}{key}: is not a key of {what}; {remedy}")
