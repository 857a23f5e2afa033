"""The structure of a vehicle, which is compiled in, and where its constants stand in a group."""

import functools
import math
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from tricycle_core.errors import VehicleError
from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.vehicle import actuators, body, steering, tyre
from tricycle_sim.vehicle.constants import Vehicle
from tricycle_sim.vehicle.layout import CONSTANTS, blocks
from tricycle_sim.vehicle.registry import PARTS, law_name, tyre_name, wheel_values
from tricycle_sim.vehicle.wheels import MOST_WHEELS


class Structure(NamedTuple):
    """Structure that is compiled in: vehicles of the same structure share their functions.

    Attributes
    ----------
    wheels : int
        Number of wheels, three or four.
    sides : tuple of int
        Steering of each wheel: 0 steered on the left or alone, 1 steered on the right, -1 not
        steered.
    driven, braked : tuple of bool
        Whether each wheel is driven, and braked.
    tyres : tuple of str
        Law of each wheel's tyre. These tuples have `MOST_WHEELS` entries.
    motor, brake, servo, steering : str
        Law of each of these parts.
    """

    wheels: int
    sides: tuple[int, ...]
    driven: tuple[bool, ...]
    braked: tuple[bool, ...]
    tyres: tuple[str, ...]
    motor: str
    brake: str
    servo: str
    steering: str


BLOCK, _FIRST_WHEEL = blocks(
    CONSTANTS,
    {"body": [body.BODY], "motor": [law.rows for law in actuators.MOTORS.values()]},
)
"""First row of each block of constants of the whole vehicle."""

WHEEL, WHEEL_ROWS = blocks(
    _FIRST_WHEEL,
    {
        "place": [body.PLACE],
        "torque_share": [law.rows for law in actuators.DRIVES.values()],
        "tyre": [tyre.TYRE],
        "tyre_law": [law.rows for law in tyre.LAWS.values()],
        "brake": [law.rows for law in actuators.BRAKES.values()],
    },
)
WHEEL_ROWS -= _FIRST_WHEEL
"""First row of each block of the first wheel's constants; rows from one wheel to the next."""

ROWS = _FIRST_WHEEL + MOST_WHEELS * WHEEL_ROWS
"""Number of rows of a group."""

_LIMIT, _SIGN = (
    steering.BLOCK.geometry + [*steering.GEOMETRY].index(row) for row in ("limit", "sign")
)


@functools.lru_cache(maxsize=256)
def structure_of(vehicle: Vehicle) -> Structure:
    """Return the structure of a vehicle.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle; its wheels and laws are used.
    """
    wheels, parts = vehicle.wheels, vehicle.parts
    steered = [wheel for wheel in wheels if wheel.steered]
    steered.sort(key=lambda wheel: -vehicle.of(wheel).y)
    missing = MOST_WHEELS - len(wheels)
    tyres = [tyre_name(wheel, parts) for wheel in wheels]
    return Structure(
        wheels=len(wheels),
        sides=(*(steered.index(w) if w.steered else -1 for w in wheels), *missing * (-1,)),
        driven=(*(wheel.driven for wheel in wheels), *missing * (False,)),
        braked=(*(wheel.braked for wheel in wheels), *missing * (False,)),
        tyres=(*tyres, *missing * tyres[:1]),
        motor=law_name("motor", wheels, parts),
        brake=law_name("brake", wheels, parts),
        servo=law_name("servo", wheels, parts),
        steering=law_name("steering", wheels, parts),
    )


def group_constants(vehicle: Vehicle, values: Mapping[str, Any]) -> dict[int, Any]:
    """Return the constants of a group by row.

    Parameters
    ----------
    vehicle : Vehicle
        Names wheels and laws.
    values : mapping
        Number, or array over vehicles, by entry of a vehicle file.
    """
    wheels, parts = vehicle.wheels, vehicle.parts
    each = wheel_values(wheels, values, vehicle.declared)
    driven = next(own for wheel, own in zip(wheels, each, strict=True) if wheel.driven)
    motor = PARTS["motor"][law_name("motor", wheels, parts)].rows
    torque_share = PARTS["drive"][law_name("drive", wheels, parts)].rows
    brake = PARTS["brake"][law_name("brake", wheels, parts)].rows
    sources = [(BLOCK.body, body.BODY, driven), (BLOCK.motor, motor, driven)]
    for index, (wheel, own) in enumerate(zip(wheels, each, strict=True)):
        at = index * WHEEL_ROWS
        law = tyre.LAWS[tyre_name(wheel, parts)].rows
        sources += [
            (WHEEL.place + at, body.PLACE, own),
            (WHEEL.tyre + at, tyre.TYRE, own),
            (WHEEL.tyre_law + at, law, own),
        ]
        if wheel.driven:
            sources.append((WHEEL.torque_share + at, torque_share, own))
        if wheel.braked:
            sources.append((WHEEL.brake + at, brake, own))
    return {
        row: formula(own)
        for first, formulas, own in sources
        for row, formula in enumerate(formulas.values(), start=first)
    }


def _steering_values(vehicle: Vehicle, values: Mapping[str, float]) -> SimpleNamespace:
    """Return the constants as the steering has them, and what follows from the wheels' places."""
    each = wheel_values(vehicle.wheels, values, vehicle.declared)
    steered = [own for wheel, own in zip(vehicle.wheels, each, strict=True) if wheel.steered]
    still = [own for wheel, own in zip(vehicle.wheels, each, strict=True) if not wheel.steered]
    ahead = sum(own.x for own in steered) / len(steered) - sum(own.x for own in still) / len(still)
    own = steered[0]
    own.steering_sign = math.copysign(1.0, ahead)
    own.wheelbase = abs(ahead)
    own.left_of_middle = 0.5 * abs(own.y - steered[-1].y)
    return own


def servo_at_rest(vehicle: Vehicle) -> FloatArray:
    """Return the state of a servo that stands at 0, as `steer` and `advance_tick` take it.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with its servo.
    """
    return np.zeros(steering.GEARED_STATES if structure_of(vehicle).servo == "geared" else 2)


def steering_columns(vehicle: Vehicle) -> list[int]:
    """Return the numbers of the unknown parameters of a vehicle that change how it steers.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with ranges of its unknown parameters.
    """
    nominal = steering_constants(vehicle, TICK)
    return [
        column
        for column, (name, ends) in enumerate(vehicle.unknown.items())
        if any(
            not np.array_equal(
                steering_constants(vehicle, TICK, {**vehicle.values, name: end}), nominal
            )
            for end in ends
        )
    ]


def check_steering(vehicle: Vehicle, *, ranges: bool = True) -> None:
    """Raise unless each wheel turns with the motor, by less than a right angle, up to its stops.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle; its nominal values are checked.
    ranges : bool
        Whether each end of its ranges is checked too.

    Raises
    ------
    VehicleError
        If a wheel does not turn so.
    """
    linkage = steering.LINKAGES[structure_of(vehicle).steering].function
    unknown = vehicle.unknown if ranges else {}
    ends = [{name: end} for name, pair in unknown.items() for end in pair]
    for changed in ({}, *ends):
        constants = steering_constants(vehicle, TICK, {**vehicle.values, **changed})
        limit, sign = constants[_LIMIT], constants[_SIGN]
        low, high = (steering.turned(linkage, constants, at)[:2] for at in (-limit, limit))
        for right, left in zip(sign * np.array(low), sign * np.array(high), strict=True):
            if not -0.5 * math.pi < right < left < 0.5 * math.pi:
                where = "".join(f" with {name} = {end:g}" for name, end in changed.items())
                raise VehicleError(
                    f"steering_limit: between the stops of the motor, -+{math.degrees(limit):.3g} "
                    f"deg, a wheel turns{where} from {math.degrees(right):.0f} to "
                    f"{math.degrees(left):.0f} deg: needs a rising angle below 90 deg to either "
                    "side"
                )


def steering_constants(
    vehicle: Vehicle, half_step: float, values: Mapping[str, float] | None = None
) -> FloatArray:
    """Return the constants of servo, linkage and caster.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with servo, linkage and caster.
    half_step : float
        Length of the servo's steps [s].
    values : mapping, optional
        Constants by entry of a vehicle file; by default the vehicle's own.

    Returns
    -------
    ndarray of float, shape (steering.SIZE,)
        Constants in the order of `steering.BLOCK`.
    """
    structure = structure_of(vehicle)
    v = _steering_values(vehicle, vehicle.values if values is None else values)
    constants = np.zeros(steering.SIZE)
    servo = actuators.SERVOS[structure.servo].rows
    for at, step_formula in enumerate(servo.values(), start=steering.BLOCK.servo):
        constants[at] = step_formula(v, half_step)
    for start, formulas in (
        (steering.BLOCK.linkage, steering.LINKAGES[structure.steering].rows),
        (steering.BLOCK.geometry, steering.GEOMETRY),
    ):
        for at, formula in enumerate(formulas.values(), start=start):
            constants[at] = formula(v)
    return constants
