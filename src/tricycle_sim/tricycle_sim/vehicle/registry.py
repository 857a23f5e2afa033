"""Every law by part and name: which ones a vehicle has, and which constants these read.

A new law is an entry of `tyre.LAWS`, `actuators.MOTORS`, `BRAKES`, `SERVOS`, `DRIVES` or
`steering.LINKAGES`.
"""

from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

from tricycle_core.errors import VehicleError
from tricycle_sim.vehicle import actuators, body, steering, tyre
from tricycle_sim.vehicle.laws import Constant, Law
from tricycle_sim.vehicle.wheels import AXLES, Wheel

PARTS: Mapping[str, Mapping[str, Law]] = {
    "tyre": tyre.LAWS,
    "motor": actuators.MOTORS,
    "brake": actuators.BRAKES,
    "servo": actuators.SERVOS,
    "steering": steering.LINKAGES,
    "drive": actuators.DRIVES,
}
"""Every law by part and name; the first law that fits the wheels is the default."""


def _default_law(part: str, wheels: Sequence[Wheel]) -> str:
    if part == "drive":
        if {wheel.axle for wheel in wheels if wheel.driven} == set(AXLES):
            return "all"
        return "single" if sum(wheel.driven for wheel in wheels) == 1 else "differential"
    if part == "steering" and sum(wheel.steered for wheel in wheels) == 1:
        return "parallel"
    return next(iter(PARTS[part]))


def law_name(part: str, wheels: Sequence[Wheel], parts: Mapping[str, str]) -> str:
    """Return the law of a part that all wheels share.

    Parameters
    ----------
    part : str
        Name in `PARTS`.
    wheels : sequence of Wheel
        Wheels of the vehicle, in its order.
    parts : mapping
        Law of each part that does not have the default law.
    """
    return parts.get(part, _default_law(part, wheels))


def tyre_name(wheel: Wheel, parts: Mapping[str, str]) -> str:
    """Return the law of a wheel's tyre.

    Parameters
    ----------
    wheel : Wheel
        Wheel of the vehicle.
    parts : mapping
        Law of each part; `front.tyre` comes before `tyre`.
    """
    names = (parts.get(spelling) for spelling, _ in wheel.spellings("tyre"))
    return next((name for name in names if name), next(iter(tyre.LAWS)))


def check_parts(wheels: Sequence[Wheel], parts: Mapping[str, str]) -> None:
    """Raise a `VehicleError` unless there are such parts, with such laws, for such wheels.

    Parameters
    ----------
    wheels : sequence of Wheel
        Wheels of the vehicle, in its order.
    parts : mapping
        Law of each part.
    """
    owners = {*AXLES, *(wheel.name for wheel in wheels)}
    for entry, name in parts.items():
        owner, _, part = entry.rpartition(".")
        if part not in PARTS or (owner and (part != "tyre" or owner not in owners)):
            known = (*PARTS, *(f"{axle}.tyre" for axle in AXLES))
            raise VehicleError(f"parts.{entry}: must be one of {', '.join(known)}")
        if name not in PARTS[part]:
            raise VehicleError(f"parts.{entry}: {name!r} must be one of {', '.join(PARTS[part])}")
    drive, fits = law_name("drive", wheels, parts), _default_law("drive", wheels)
    if drive != fits:
        raise VehicleError(f"parts.drive: {drive} does not fit the driven wheels; {fits} does")
    linkage = law_name("steering", wheels, parts)
    if linkage != "parallel" and sum(wheel.steered for wheel in wheels) != 2:
        raise VehicleError(f"parts.steering: {linkage} steers two wheels; parallel fits")


def declared(wheels: Sequence[Wheel], parts: Mapping[str, str]) -> dict[str, Constant]:
    """Return the constants that a vehicle's parts read, by name, in the order of fingerprints.

    Parameters
    ----------
    wheels : sequence of Wheel
        Wheels of the vehicle, in its order.
    parts : mapping
        Law of each part.
    """

    def law(part: str) -> tuple[Constant, ...]:
        return PARTS[part][law_name(part, wheels, parts)].constants

    tyres = dict.fromkeys(tyre_name(wheel, parts) for wheel in wheels)
    groups = (
        body.BODY_CONSTANTS,
        body.WHEEL_CONSTANTS,
        tyre.CONSTANTS,
        *(tyre.LAWS[name].constants for name in tyres),
        steering.CONSTANTS,
        law("steering"),
        law("servo"),
        actuators.STEERING_SLEW,
        actuators.DRIVE_SLEW,
        law("motor"),
        law("drive"),
        law("brake"),
        body.ROAD_CONSTANTS,
    )
    return {constant.name: constant for group in groups for constant in group}


def other_owner(name: str) -> str | None:
    """Return which law that a vehicle may have reads a constant, for a message; None: no one does.

    Parameters
    ----------
    name : str
        Entry of a vehicle file that this vehicle does not read.
    """
    plain = name.rpartition(".")[2]
    for part, laws in PARTS.items():
        for law, content in laws.items():
            if any(constant.name == plain for constant in content.constants):
                return f"the {part} {law}"
    return None


def reads(wheel: Wheel, parts: Mapping[str, str], constant: Constant) -> bool:
    """Return whether a wheel reads a constant; one of a tyre's law only with that law.

    Parameters
    ----------
    wheel : Wheel
        Wheel of the vehicle.
    parts : mapping
        Law of each part.
    constant : Constant
        Constant, from `declared`.
    """
    own = tyre.LAWS[tyre_name(wheel, parts)].constants
    return constant in own or not any(constant in law.constants for law in tyre.LAWS.values())


def wheel_values(
    wheels: Sequence[Wheel], values: Mapping[str, Any], declarations: Mapping[str, Constant]
) -> list[SimpleNamespace]:
    """Return the constants as each wheel has them, its own before its axle's before all wheels'.

    Parameters
    ----------
    wheels : sequence of Wheel
        Wheels of the vehicle, in its order.
    values : mapping
        Number or array of each entry of a vehicle file.
    declarations : mapping
        Constants by name, from `declared`.
    """
    shared = {name: value for name, value in values.items() if "." not in name}
    shared["mean_load"] = values["mass"] * values["gravity"] / float(len(wheels))
    shared["braked_wheels"] = float(sum(wheel.braked for wheel in wheels))
    found = []
    for wheel in wheels:
        own: dict[str, Any] = {
            "in_front": wheel.axle == "front",
            "abreast": float(sum(other.axle == wheel.axle for other in wheels)),
        }
        for name, constant in declarations.items():
            if not constant.per_wheel:
                continue
            for entry, factor in wheel.spellings(name):
                if entry in values:
                    own[name] = values[entry] if factor == 1.0 else factor * values[entry]
                    break
        found.append(SimpleNamespace(**shared | own))
    return found
