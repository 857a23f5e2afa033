"""Whether a plan suits a vehicle: the laws and constants of the vehicle that shape its commands.

A plan holds commands that were found with one vehicle. Where another one differs in geometry,
mass, steering or limits, they drive another path and may not be feasible. What drives identify, and
constants such as those of tyres and losses, may differ: the drive is there to find them.
"""

from collections.abc import Collection, Iterable
from dataclasses import replace
from math import isclose
from typing import TYPE_CHECKING

from tricycle_core.errors import PlanError
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.registry import PARTS, law_name, tyre_name

if TYPE_CHECKING:
    from excitation_planner.plan import Plan

SHAPING = (
    *("com_to_front_axle", "com_to_rear_axle", "left_wheel_y", "right_wheel_y", "rear_wheel_y"),
    *("mass", "com_height", "tyre_radius", "caster_angle", "steering_limit", "steering_margin"),
    *("steering_ratio_straight", "steering_ratio_full", "steering_ratio_smoothing"),
    *("steering_slew", "acceleration", "x", "y", "steering_gain", "steering_offset"),
    "steering_scale",
)
"""Constants, of a vehicle, an axle or a wheel, on which the commands depend."""

TOLD = 4
"""Differences that are named; another vehicle altogether has dozens."""


def shaping_constants(vehicle: Vehicle) -> dict[str, float]:
    """Return the constants that shape commands, by name; those that are unknown do not.

    Parameters
    ----------
    vehicle : Vehicle
        Has the values.
    """
    return {
        name: float(value)
        for name, value in vehicle.values.items()
        if name.rpartition(".")[2] in SHAPING and name not in vehicle.unknown
    }


def laws_of(vehicle: Vehicle) -> dict[str, str]:
    """Return the law of each part; of tyres by wheel, where they differ.

    Parameters
    ----------
    vehicle : Vehicle
        Has the parts.
    """
    tyres = {f"{w.name}.tyre": tyre_name(w, vehicle.parts) for w in vehicle.wheels}
    if len(set(tyres.values())) == 1:
        tyres = {"tyre": next(iter(tyres.values()))}
    others = (part for part in PARTS if part != "tyre")
    return tyres | {part: law_name(part, vehicle.wheels, vehicle.parts) for part in others}


def check_motor(vehicle: Vehicle) -> None:
    """Refuse a vehicle for which no maneuver can be planned: its motor holds no speed.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle that is to be planned for.

    Raises
    ------
    PlanError
        If its motor does not hold a speed; the message names one that does.
    """
    if not vehicle.has_speed_loop:
        raise PlanError(
            f"{vehicle.name}: maneuvers are driven at a speed, and parts.motor: "
            f"{vehicle.parts['motor']} has no speed loop; hub_motor has one"
        )


def planned_for(plan: "Plan", vehicle: Vehicle) -> "Plan":
    """Return a plan made with corrected values of a vehicle as one for the vehicle's file.

    The nodes that drive it are set up with the file, and the boards' tyre radius is its.

    Parameters
    ----------
    plan : Plan
        Plan made with the same vehicle, corrected by effects.
    vehicle : Vehicle
        Vehicle of the file.
    """
    return replace(
        plan,
        vehicle_hash=vehicle.fingerprint,
        constants=shaping_constants(vehicle),
        parts=laws_of(vehicle),
        tyre_radius=vehicle.driven_radius,
    )


def check_vehicle(plan: "Plan", vehicle: Vehicle) -> None:
    """Refuse a plan if the vehicle differs in a law or constant that shapes the commands.

    Parameters
    ----------
    plan : Plan
        Plan to be driven.
    vehicle : Vehicle
        Vehicle that is to drive it.

    Raises
    ------
    PlanError
        If they differ; the message names the laws and constants, with both values.
    """
    laws, here = laws_of(vehicle), _values_of(plan.constants, vehicle)
    differing = [
        f"{name} {planned:.6g}, which it does not have"
        if name not in here
        else f"{name} {planned:.6g} instead of {' and '.join(f'{value:.6g}' for value in others)}"
        for name, planned in plan.constants.items()
        if (others := _others(planned, here.get(name, ()))) or name not in here
    ]
    differing += [
        f"parts.{part} {law} instead of {laws.get(part, 'several')}"
        for part, law in plan.parts.items()
        if laws.get(part) != law
    ]
    if differing:
        more = f" and {len(differing) - TOLD} more" if len(differing) > TOLD else ""
        raise PlanError(
            f"plan {plan.id} is for another vehicle ({plan.vehicle}) than {vehicle.name}: "
            f"{', '.join(differing[:TOLD])}{more}; plan again for this vehicle"
        )


def _values_of(names: Collection[str], vehicle: Vehicle) -> dict[str, list[float]]:
    """Return the known values that a vehicle has for entries, however its own file spells them."""
    found = {name: [vehicle.values[name]] for name in names if name in vehicle.values}
    by_wheel: dict[str, list[float]] = {}
    for name in (c.name for c in vehicle.declared.values() if c.per_wheel):
        for wheel in vehicle.wheels:
            spelt = wheel.spellings(name)
            own = next((entry for entry, _ in spelt if entry in vehicle.values), None)
            asked = next(((entry, sign) for entry, sign in spelt if entry in names), None)
            if own is not None and asked is not None:
                values = by_wheel.setdefault(asked[0], [])
                if own not in vehicle.unknown:
                    values.append(asked[1] * getattr(vehicle.of(wheel), name))
    found |= by_wheel
    return {name: [] if name in vehicle.unknown else values for name, values in found.items()}


def _others(planned: float, values: Iterable[float]) -> list[float]:
    """Return each of the values that differs from that of a plan, once."""
    return [v for v in dict.fromkeys(values) if not isclose(planned, v, rel_tol=1e-9)]
