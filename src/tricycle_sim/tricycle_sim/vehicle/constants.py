"""A vehicle: its wheels, its laws, and every number of them.

Everything that the model of `docs/model.md` needs is one number of a `Vehicle`, in SI units.
Letters of array shapes: `n` samples, `k` unknown parameters, `t` time points.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import json
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np

from tricycle_core.errors import VehicleError, hint
from tricycle_core.quantities import FloatArray
from tricycle_sim.vehicle.body import SHORTHANDS, upward
from tricycle_sim.vehicle.laws import Constant
from tricycle_sim.vehicle.registry import (
    PARTS,
    check_parts,
    declared,
    law_name,
    other_owner,
    reads,
    wheel_values,
)
from tricycle_sim.vehicle.wheels import AXLES, TADPOLE, Wheel, check_wheels

UNKNOWN_PARAMETERS: tuple[str, ...] = (
    "cornering_stiffness",
    "camber_stiffness",
    "self_aligning_stiffness",
    "yaw_inertia",
    "rolling_coefficient_1",
    "rolling_coefficient_2",
    "road_grade",
    "road_bank",
)
"""The unknown parameters that come first, in this order; others follow in the file's order."""


@dataclass(frozen=True, kw_only=True)
class Vehicle:
    """A vehicle with three or four wheels, validated on creation.

    Body frame at the centre of mass (COM): x forward, y left, z up (REP-103). The road is a plane,
    level by default; the world's frame lies in it. Each shared constant is an attribute too:
    `vehicle.mass`; of an unknown parameter it is the nominal value.

    Attributes
    ----------
    name : str
        Name of the vehicle.
    values : mapping of str to float
        Every constant by its entry in a vehicle file: `mass`, `front.cornering_stiffness`.
    unknown : mapping of str to (float, float)
        Range of each unknown parameter.
    parts : mapping of str to str
        Law of each part that does not have the default law.
    wheels : tuple of Wheel
        The three or four wheels, in the order used everywhere.

    Raises
    ------
    VehicleError
        If an entry is missing, unknown to the vehicle or out of its range; the message names the
        first.
    """

    name: str
    values: Mapping[str, float]
    unknown: Mapping[str, tuple[float, float]]
    parts: Mapping[str, str] = field(default_factory=dict)
    wheels: tuple[Wheel, ...] = TADPOLE

    def __post_init__(self) -> None:
        entries = constant_entries(self.wheels, self.parts)
        for name in (*self.values, *self.unknown):
            check_entry(name, entries)
        missing = missing_entries(self.wheels, self.parts, self.values)
        if missing:
            raise VehicleError("; ".join(missing))
        defaults = {c.name: c.default for c in self.declared.values() if c.default is not None}
        values = {
            name: float(self.values[name]) if name in self.values else defaults[name]
            for name in entries
            if name in self.values or name in defaults
        }
        object.__setattr__(self, "values", values)
        for name, value in values.items():
            entries[name].check(name, value)
        for name, (low, high) in self.unknown.items():
            if entries[name].setting:
                raise VehicleError(
                    f"{name}: cannot be unknown: it is a setting of the boards or of plans, or of "
                    "the supply, and set-points move the vehicle in the same way whatever it is; "
                    "give it a value"
                )
            for value in (low, high):
                entries[name].check(f"{name}.range", value)
            if not low < high:
                raise VehicleError(f"{name}.range: [{low:g}, {high:g}] is upside down or empty")
            if name not in values:
                raise VehicleError(f"{name}.nominal: is missing")
            if not low <= values[name] <= high:
                raise VehicleError(
                    f"{name}.nominal: {values[name]:g} is outside [{low:g}, {high:g}]"
                )
        first = [name for name in UNKNOWN_PARAMETERS if name in self.unknown]
        rest = [name for name in self.unknown if name not in first]
        ordered = {name: self.unknown[name] for name in (*first, *rest)}
        object.__setattr__(self, "unknown", ordered)
        self._check_places()

    def _check_places(self) -> None:
        places = {wheel.name: self.of(wheel) for wheel in self.wheels}
        for front in (wheel for wheel in self.wheels if wheel.axle == "front"):
            for rear in (wheel for wheel in self.wheels if wheel.axle == "rear"):
                if not places[front.name].x > places[rear.name].x:
                    raise VehicleError(f"{front.name}.x: is not in front of {rear.name}.x")
        for axle in AXLES:
            names = [wheel.name for wheel in self.wheels if wheel.axle == axle]
            if len(names) == 2 and places[names[0]].y == places[names[1]].y:
                raise VehicleError(f"{names[0]}.y: is also {names[1]}.y")

    def __getattr__(self, name: str) -> float:
        values = self.__dict__.get("values", {})
        if name in values:
            return float(values[name])
        raise AttributeError(f"{name}: the vehicle has no such constant for all its wheels")

    @functools.cached_property
    def declared(self) -> dict[str, Constant]:
        """Constants that the vehicle's parts read, by name."""
        check_wheels(self.wheels)
        check_parts(self.wheels, self.parts)
        return declared(self.wheels, self.parts)

    @functools.cached_property
    def _by_wheel(self) -> dict[str, SimpleNamespace]:
        each = wheel_values(self.wheels, self.values, self.declared)
        return {wheel.name: own for wheel, own in zip(self.wheels, each, strict=True)}

    def of(self, wheel: Wheel | str) -> SimpleNamespace:
        """Return the constants as a wheel has them, as attributes: place `x`, `y`, `tyre_radius`.

        Parameters
        ----------
        wheel : Wheel or str
            One of the vehicle's, or its name.
        """
        return self._by_wheel[wheel if isinstance(wheel, str) else wheel.name]

    def bounds(self, name: str) -> tuple[float, float]:
        """Return the interval in which a constant of any vehicle lies.

        Parameters
        ----------
        name : str
            Entry of a vehicle file: `front.cornering_stiffness`.
        """
        constant = constant_entries(self.wheels, self.parts)[name]
        return constant.low, constant.high

    def unit(self, name: str) -> str:
        """Return the unit of a constant.

        Parameters
        ----------
        name : str
            Entry of a vehicle file: `front.cornering_stiffness`.
        """
        return constant_entries(self.wheels, self.parts)[name].unit

    def axle_x(self, axle: str) -> float:
        """Return where an axle is in front of the centre of mass, in the mean of its wheels [m].

        Parameters
        ----------
        axle : str
            `front` or `rear`.
        """
        return float(np.mean([self.of(wheel).x for wheel in self.wheels if wheel.axle == axle]))

    @property
    def com_to_front_axle(self) -> float:
        """Distance of the front axle from the centre of mass [m]."""
        return self.axle_x("front")

    @property
    def com_to_rear_axle(self) -> float:
        """Distance of the rear axle from the centre of mass [m]."""
        return -self.axle_x("rear")

    @property
    def wheelbase(self) -> float:
        """Distance of the axles [m]."""
        return self.axle_x("front") - self.axle_x("rear")

    @property
    def driven_radius(self) -> float:
        """Radius [m] of the driven wheels' tyres: that of the boards' speed and travel."""
        return float(next(self.of(wheel).tyre_radius for wheel in self.wheels if wheel.driven))

    @property
    def has_speed_loop(self) -> bool:
        """Whether the motor's set-point is a speed that a controller holds."""
        return "integral" in PARTS["motor"][law_name("motor", self.wheels, self.parts)].rows

    @property
    def nominal(self) -> dict[str, float]:
        """Nominal value by name of each unknown parameter, in the order of `unknown`."""
        return {name: self.values[name] for name in self.unknown}

    @property
    def steering_reach(self) -> float:
        """Largest angle of the steering motor in a plan [rad]: the margin before its end stop."""
        return self.steering_limit * (1.0 - self.steering_margin)

    def __hash__(self) -> int:
        """Return a number for caches of what follows from a vehicle."""
        return hash(self.fingerprint)

    def __getstate__(self) -> dict[str, Any]:
        """Pickle without what follows: a plan sends a vehicle to its workers a hundred times."""
        return {entry.name: getattr(self, entry.name) for entry in dataclasses.fields(self)}

    @functools.cached_property
    def fingerprint(self) -> str:
        """Sixteen hexadecimal digits that change with any value, range or law of the vehicle."""
        entries = constant_entries(self.wheels, self.parts)
        values = {n: value for n, value in self.values.items() if value != entries[n].default}
        content: list[Any] = [values, dict(self.unknown)]
        if self.parts or self.wheels != TADPOLE:
            content.append(dict(self.parts))
        if self.wheels != TADPOLE:
            content.append([dataclasses.astuple(wheel) for wheel in self.wheels])
        text = json.dumps(content)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def nominal_point(self) -> FloatArray:
        """Nominal values of the unknown parameters, shape (k,)."""
        return np.array(list(self.nominal.values()))

    def static_loads(self) -> tuple[float, ...]:
        """Return the load of each wheel at rest [N], in the order of the wheels.

        By the balance of force and moments of the rigid body; of four wheels the stiffness of the
        tyres decides. It heads +x, held by its tyres where the road is not level.
        """
        x, y, z = (self.mass * self.gravity * float(part) for part in upward(self))
        each = [self.of(wheel) for wheel in self.wheels]
        arms = np.array([[1.0, own.x, own.y] for own in each]).T
        stiffness = np.array([own.vertical_stiffness for own in each])
        balance = np.array([z, -x * self.com_height, -y * self.com_height])
        return tuple(
            (stiffness * (arms.T @ np.linalg.solve(arms * stiffness @ arms.T, balance))).tolist()
        )

    def axle_stiffness(self) -> dict[str, float]:
        """Return the cornering stiffness of each axle [N/rad], of its tyres loaded as at rest."""
        stiffness = dict.fromkeys(AXLES, 0.0)
        for wheel, load in zip(self.wheels, self.static_loads(), strict=True):
            own = self.of(wheel)
            by_load = 1.0 + own.load_sensitivity * (load / own.mean_load - 1.0)
            stiffness[wheel.axle] += by_load * own.cornering_stiffness
        return stiffness

    def replace(self, **values: float) -> Vehicle:
        """Return the vehicle with other values.

        Parameters
        ----------
        **values : float
            New value by the constant's name, in its unit; for an unknown parameter the nominal
            value.

        Raises
        ------
        VehicleError
            If a name is not a constant of a vehicle, no wheel reads it, or a value is out of its
            range.
        """
        entries = constant_entries(self.wheels, self.parts)
        for name in values:
            check_entry(name, entries)
        given = {**self.values, **values}
        check_read(self.wheels, self.parts, given, told={*values, *self.unknown})
        return dataclasses.replace(self, values=given)


def constant_entries(wheels: tuple[Wheel, ...], parts: Mapping[str, str]) -> dict[str, Constant]:
    """Return the entries that a vehicle file may have, in the order of fingerprints.

    Parameters
    ----------
    wheels : tuple of Wheel
        Wheels of the vehicle, in its order.
    parts : mapping
        Law of each part.

    Returns
    -------
    dict of str to Constant
        Constants by entry: `tyre_radius`, `front.tyre_radius`, `left.tyre_radius`.
    """
    return _entries(wheels, tuple(parts.items()))


@functools.cache
def _entries(wheels: tuple[Wheel, ...], parts: tuple[tuple[str, str], ...]) -> dict[str, Constant]:
    check_wheels(wheels)
    check_parts(wheels, dict(parts))
    entries: dict[str, Constant] = {}
    for constant in declared(wheels, dict(parts)).values():
        if not constant.per_wheel:
            entries[constant.name] = constant
            continue
        names = [
            name
            for wheel in wheels
            if reads(wheel, dict(parts), constant)
            for name, _ in wheel.spellings(constant.name)
        ]
        for name in sorted(dict.fromkeys(names), key=lambda name: "." in name):
            entries[name] = dataclasses.replace(
                SHORTHANDS.get(name, constant), default=constant.default
            )
    return entries


def check_entry(name: str, entries: Mapping[str, Constant]) -> None:
    """Raise a `VehicleError` unless a vehicle has a constant; the message suggests one.

    Parameters
    ----------
    name : str
        Entry of a vehicle file.
    entries : mapping
        Constants by entry, from `constant_entries`.
    """
    if name in entries:
        return
    plain = name.rpartition(".")[2]
    meant = hint(name, entries)
    if owner := other_owner(name):
        meant = f"{owner} reads it, and this vehicle has none{' there' if plain != name else ''}"
    elif plain in entries and plain != name:
        meant = f"did you mean {plain}?"
    raise VehicleError(f"{name}: is not a constant of this vehicle; {meant}")


def missing_entries(
    wheels: tuple[Wheel, ...], parts: Mapping[str, str], given: Iterable[str]
) -> list[str]:
    """Return one message per constant that a vehicle file lacks.

    Parameters
    ----------
    wheels : tuple of Wheel
        Wheels of the vehicle, in its order.
    parts : mapping
        Law of each part.
    given : iterable of str
        Entries that the vehicle has.
    """
    names = set(given)
    entries = constant_entries(wheels, parts)

    def missing() -> Iterator[str]:
        for constant in declared(wheels, parts).values():
            if constant.default is not None:
                continue
            if not constant.per_wheel:
                if constant.name not in names:
                    yield constant.name
                continue
            readers = [wheel for wheel in wheels if reads(wheel, parts, constant)]
            bare = [
                wheel
                for wheel in readers
                if not names & {entry for entry, _ in wheel.spellings(constant.name)}
            ]
            if len(bare) == len(readers) and constant.name in entries:
                yield constant.name
            else:
                yield from dict.fromkeys(
                    _entry_for(constant, wheel, bare, wheels) for wheel in bare
                )

    return [f"{name}: is missing ({entries[name].unit})" for name in missing()]


def check_read(
    wheels: tuple[Wheel, ...],
    parts: Mapping[str, str],
    given: Iterable[str],
    told: Collection[str] | None = None,
) -> None:
    """Raise a `VehicleError` for an entry that no wheel reads, as each has a more specific one.

    Parameters
    ----------
    wheels : tuple of Wheel
        Wheels of the vehicle, in its order.
    parts : mapping
        Law of each part.
    given : iterable of str
        All entries that the vehicle has.
    told : collection of str, optional
        Entries that must be read by a wheel; by default all.
    """
    names = set(given)
    looked_at = names if told is None else set(told)
    for constant in declared(wheels, parts).values():
        if not constant.per_wheel:
            continue
        spelt = [
            [name for name, _ in wheel.spellings(constant.name) if name in names]
            for wheel in wheels
            if reads(wheel, parts, constant)
        ]
        read = {entries[0] for entries in spelt if entries}
        for name in (name for entries in spelt for name in entries if name in looked_at - read):
            first = " and ".join(dict.fromkeys(e[0] for e in spelt if name in e))
            raise VehicleError(f"{name}: no wheel reads it, but {first} instead; leave it out")


def _entry_for(
    constant: Constant, wheel: Wheel, bare: list[Wheel], wheels: tuple[Wheel, ...]
) -> str:
    """Return the entry to ask for where a wheel lacks a constant."""
    own, axle, *shorthands = wheel.spellings(constant.name)
    if wheels == TADPOLE:
        return shorthands[0][0]
    whole = all(other in bare for other in wheels if other.axle == wheel.axle)
    return axle[0] if whole and constant.name != "y" else own[0]


def draw_truth(vehicle: Vehicle, rng: np.random.Generator) -> dict[str, float]:
    """Return random values of the unknown parameters by name, uniform in their ranges.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with the ranges of its unknown parameters.
    rng : Generator
        Random generator.
    """
    return {name: float(rng.uniform(low, high)) for name, (low, high) in vehicle.unknown.items()}
