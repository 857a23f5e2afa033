"""The constants of a tricycle: a documented YAML file, validated on load.

Everything that the model of `docs/model.md` needs is one number of a `Vehicle`, in SI units. In the
file each number stands with its unit, what it rests on (data, argued, literature, interpreted) and
why. Letters of array shapes: `n` samples, `k` unknown parameters, `t` time points.
"""

import dataclasses
import difflib
import enum
import hashlib
import json
import math
import reprlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from tricycle_core.errors import VehicleError
from tricycle_core.quantities import FloatArray

UNKNOWN_PARAMETERS: tuple[str, ...] = (
    "cornering_stiffness",
    "camber_stiffness",
    "self_aligning_stiffness",
    "yaw_inertia",
    "rolling_coefficient_1",
    "rolling_coefficient_2",
)
"""The parameters that a vehicle file may leave unknown, in their order everywhere."""


MAX_BYTES = 1_000_000  # of a vehicle file


class Basis(enum.Enum):
    """What a number of the vehicle file rests on."""

    DATA = "data"  # measured or published for this vehicle
    ARGUED = "argued"  # our choice, with its reason
    LITERATURE = "literature"  # typical value from the literature
    INTERPRETED = "interpreted"  # the source is silent or contradictory; this is our reading


def _constant(
    unit: str, *, low: float = 0.0, high: float = math.inf, zero: bool = False
) -> dict[str, Any]:
    """Metadata of a field: its unit and its interval, which excludes `low` unless `zero`."""
    return {"unit": unit, "low": low, "high": high, "zero": zero}


def _positive(unit: str) -> float:
    value: float = field(metadata=_constant(unit))
    return value


def _not_negative(unit: str) -> float:
    value: float = field(metadata=_constant(unit, zero=True))
    return value


def _between(unit: str, low: float, high: float) -> float:
    value: float = field(metadata=_constant(unit, low=low, high=high, zero=True))
    return value


def _any(unit: str) -> float:
    value: float = field(metadata=_constant(unit, low=-math.inf))
    return value


@dataclass(frozen=True, kw_only=True)
class Vehicle:
    """A tricycle (two steered wheels in front, one driven behind), validated on creation.

    Body frame at the centre of mass (COM): x forward, y left, z up (REP-103). The six
    `UNKNOWN_PARAMETERS` hold their nominal values; those listed in `unknown` are uncertain.

    Raises
    ------
    VehicleError
        Naming the first constant that is not finite or out of its range.
    """

    name: str
    # body
    gravity: float = _positive("m/s^2")
    mass: float = _positive("kg")
    roll_inertia: float = _positive("kg m^2")
    pitch_inertia: float = _positive("kg m^2")
    yaw_inertia: float = _positive("kg m^2")
    air_drag: float = _not_negative("N s^2/m^2")  # force against u per u |u|
    rollover_angle: float = _between("rad", 0.2, 1.3)  # tilt at which a run is ended
    # geometry
    com_to_front_axle: float = _positive("m")
    com_to_rear_axle: float = _positive("m")
    left_wheel_y: float = _positive("m")
    right_wheel_y: float = field(metadata=_constant("m", low=-math.inf, high=0.0))
    rear_wheel_y: float = _any("m")
    com_height: float = _positive("m")  # with unloaded tyres
    tyre_radius: float = _positive("m")  # unloaded
    # wheels and tyres; every wheel has the same tyre
    front_wheel_inertia: float = _positive("kg m^2")  # about the axle, each
    rear_wheel_inertia: float = _positive("kg m^2")
    cornering_stiffness: float = _positive("N/rad")
    camber_stiffness: float = _not_negative("N/rad")
    self_aligning_stiffness: float = _not_negative("N m/rad")
    rolling_coefficient_1: float = _not_negative("1")
    rolling_coefficient_2: float = _not_negative("s^2/m^2")
    vertical_stiffness: float = _positive("N/m")
    vertical_damping: float = _not_negative("N s/m")
    friction_coefficient: float = _positive("1")
    load_sensitivity: float = _between("1", 0.0, 1.0)  # 0: stiffness per wheel, 1: per load
    slip_stiffness: float = _positive("N")  # longitudinal, per unit slip
    longitudinal_relaxation_length: float = _positive("m")
    lateral_relaxation_length: float = _positive("m")
    slip_speed_floor: float = _positive("m/s")
    carcass_damping_speed: float = _positive("m/s")  # the damping fades out above it
    longitudinal_carcass_damping: float = _not_negative("N s/m")
    lateral_carcass_damping: float = _not_negative("N s/m")
    rolling_smoothing_speed: float = _positive("m/s")
    # steering
    caster_angle: float = _between("rad", -0.7, 0.7)
    steering_limit: float = _between("rad", 0.01, 1.2)  # of the motor
    steering_ratio_straight: float = _between("1", 0.3, 1.0)  # outer to inner wheel
    steering_ratio_full: float = _between("1", 0.3, 1.0)  # at the limit
    steering_ratio_smoothing: float = _positive("rad")
    servo_natural_frequency: float = _positive("rad/s")
    servo_damping_ratio: float = _positive("1")
    steering_slew: float = _positive("rad/s")  # of the set-point, on the PLC
    # drive
    acceleration: float = _positive("m/s^2")  # slew of the speed set-point, on the PLC
    motor_power: float = _positive("W")
    motor_torque: float = _positive("N m")
    regenerative_torque: float = _not_negative("N m")
    motor_no_load_speed: float = _positive("rad/s")
    motor_slope: float = _positive("N m s/rad")
    motor_lag: float = _positive("s")
    motor_copper_loss: float = _not_negative("W/(N m)^2")  # per torque squared
    battery_voltage: float = _positive("V")
    speed_gain_proportional: float = _positive("N m s/rad")
    speed_gain_integral: float = _not_negative("N m/rad")
    speed_anti_windup: float = _not_negative("rad/(N m s)")
    brake_torque: float = _not_negative("N m")
    brake_smoothing_speed: float = _positive("rad/s")
    # what is not known
    unknown: Mapping[str, tuple[float, float]]

    def __post_init__(self) -> None:
        for constant in constants():
            _check_value(constant.name, getattr(self, constant.name), constant.metadata)
        units = {constant.name: constant.metadata for constant in constants()}
        for name, (low, high) in self.unknown.items():
            if name not in UNKNOWN_PARAMETERS:
                raise VehicleError(
                    f"{name}: cannot be unknown; only {', '.join(UNKNOWN_PARAMETERS)} can"
                )
            for value in (low, high):
                _check_value(f"{name}.range", value, units[name])
            if not low < high:
                raise VehicleError(f"{name}.range: [{low:g}, {high:g}] is upside down or empty")
            if not low <= getattr(self, name) <= high:
                raise VehicleError(
                    f"{name}.nominal: {getattr(self, name):g} is outside [{low:g}, {high:g}]"
                )
        ordered = {name: self.unknown[name] for name in UNKNOWN_PARAMETERS if name in self.unknown}
        object.__setattr__(self, "unknown", ordered)

    @property
    def nominal(self) -> dict[str, float]:
        """Nominal value by name of each unknown parameter, in the order of `unknown`."""
        return {name: getattr(self, name) for name in self.unknown}

    @property
    def file_hash(self) -> str:
        """Sixteen hexadecimal digits that change with any value or range, not with comments."""
        values = {constant.name: getattr(self, constant.name) for constant in constants()}
        content = json.dumps([values, dict(self.unknown)])
        return hashlib.sha256(content.encode()).hexdigest()[:16]

    def nominal_point(self) -> FloatArray:
        """Nominal values of the unknown parameters, shape (k,)."""
        return np.array(list(self.nominal.values()))

    def static_loads(self) -> tuple[float, float, float]:
        """Wheel loads left, right, rear at rest [N], by moment balance of the rigid vehicle."""
        weight = self.mass * self.gravity
        rear = weight * self.com_to_front_axle / (self.com_to_front_axle + self.com_to_rear_axle)
        front = weight - rear
        track = self.left_wheel_y - self.right_wheel_y
        left = -(front * self.right_wheel_y + rear * self.rear_wheel_y) / track
        return left, front - left, rear

    def replace(self, **values: float) -> "Vehicle":
        """Return the vehicle with other values; of an unknown parameter this sets the nominal one.

        Raises
        ------
        VehicleError
            If a name is no constant of a vehicle or a value is out of its range.
        """
        names = [constant.name for constant in constants()]
        for name in values:
            if name not in names:
                raise VehicleError(f"{name}: is no constant of a vehicle; {_suggest(name, names)}")
        return dataclasses.replace(self, **values)  # type: ignore[arg-type]

    def warnings(self) -> tuple[str, ...]:
        """What is physically impossible or doubtful about this vehicle, a line each."""
        return tuple(_doubts(self))


def constants() -> list[dataclasses.Field[Any]]:
    """Return the fields of `Vehicle` that are numbers; metadata: unit, low, high, zero."""
    return [entry for entry in dataclasses.fields(Vehicle) if "unit" in entry.metadata]


def load_vehicle(path: Path | None = None) -> Vehicle:
    """Read a vehicle file (None: the tricycle that comes with the package).

    Raises
    ------
    VehicleError
        One line that names file and entry, if the file is not a complete and valid vehicle.
    OSError
        If the file cannot be read.
    """
    if path is None:
        source = resources.files("tricycle_sim") / "tricycle.yaml"
        return _parse(source.read_text(encoding="utf-8"), "tricycle.yaml")
    with Path(path).open("rb") as file:
        content = file.read(MAX_BYTES + 1)
    if len(content) > MAX_BYTES:
        raise VehicleError(f"{path}: larger than {MAX_BYTES} bytes; not a vehicle file")
    try:
        return _parse(content.decode(), str(path))
    except VehicleError:
        raise
    # numbers beyond all bounds, dates that do not exist, lists a thousand deep
    except (ValueError, OverflowError, RecursionError) as error:
        raise VehicleError(f"{path}: is not a vehicle file: {error}") from error


class _Loader(yaml.SafeLoader):
    """YAML without aliases, by which a small file describes an enormous document."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("aliases are not read")
        return super().compose_node(parent, index)


def _parse(text: str, where: str) -> Vehicle:
    try:
        document = yaml.load(text, Loader=_Loader)  # noqa: S506 - a safe loader
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f":{mark.line + 1}" if mark else ""
        raise VehicleError(f"{where}{line}: is not valid YAML, or has aliases") from error
    if not isinstance(document, dict) or not isinstance(document.get("constants"), dict):
        raise VehicleError(f"{where}: needs the keys 'name' and 'constants'")
    if unexpected := set(document) - {"name", "about", "constants"}:
        raise VehicleError(f"{where}: {min(map(str, unexpected))}: is no key of a vehicle file")
    if not isinstance(document.get("name"), str) or not document["name"]:
        raise VehicleError(f"{where}: name: needs a text")
    entries = document["constants"]
    names = [constant.name for constant in constants()]
    for name in entries:
        if name not in names:
            raise VehicleError(f"{where}: {name}: is no constant; {_suggest(str(name), names)}")
    values: dict[str, float] = {}
    unknown: dict[str, tuple[float, float]] = {}
    for constant in constants():
        if constant.name not in entries:
            raise VehicleError(
                f"{where}: {constant.name}: is missing ({constant.metadata['unit']})"
            )
        try:
            value, limits = _parse_entry(constant, entries[constant.name])
        except VehicleError as error:
            raise VehicleError(f"{where}: {error}") from error
        values[constant.name] = value
        if limits is not None:
            unknown[constant.name] = limits
    try:
        return Vehicle(name=document["name"], **values, unknown=unknown)
    except VehicleError as error:
        raise VehicleError(f"{where}: {error}") from error


def _parse_entry(
    constant: dataclasses.Field[Any], entry: object
) -> tuple[float, tuple[float, float] | None]:
    """Return the value of an entry and, of an unknown parameter, its range."""
    name, unit = constant.name, constant.metadata["unit"]
    if not isinstance(entry, dict):
        raise VehicleError(f"{name}: needs value (or nominal and range), unit, basis and about")
    if unexpected := set(entry) - {"value", "nominal", "range", "unit", "basis", "about"}:
        raise VehicleError(f"{name}.{min(map(str, unexpected))}: is no key of a constant")
    scale = 1.0
    if unit == "rad" and entry.get("unit") == "deg":
        scale = math.pi / 180.0
    elif entry.get("unit") != unit:
        raise VehicleError(f"{name}.unit: needs '{unit}', not {reprlib.repr(entry.get('unit'))}")
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
    if isinstance(value, bool) or not isinstance(value, int | float):
        found = reprlib.repr(value)
        raise VehicleError(f"{where}: needs a number, not {found} (YAML wants 5.0e-4 for 5e-4)")
    return float(value)


def _check_value(where: str, value: float, metadata: Mapping[str, Any]) -> None:
    low, high, zero = metadata["low"], metadata["high"], metadata["zero"]
    inside = (low <= value if zero else low < value) and value <= high and math.isfinite(value)
    if not inside:
        bounds = f"{'[' if zero else '('}{low:g}, {high:g}]"
        raise VehicleError(f"{where}: {value:g} {metadata['unit']} is not in {bounds}")


def _suggest(name: str, names: list[str]) -> str:
    close = difflib.get_close_matches(name, names, n=1)
    return f"did you mean {close[0]}?" if close else "see tricycle.yaml for the names"


def _doubts(vehicle: Vehicle) -> list[str]:
    doubts: list[str] = []
    inertia = {
        "roll_inertia": vehicle.roll_inertia,
        "pitch_inertia": vehicle.pitch_inertia,
        "yaw_inertia": vehicle.yaw_inertia,
    }
    for name, value in inertia.items():
        others = sum(inertia.values()) - value
        if value > others:
            doubts.append(
                f"{name}: {value:g} kg m^2 is larger than the sum of the other two, {others:g}: "
                "no rigid body has such inertia"
            )
    if "yaw_inertia" in vehicle.unknown:
        high, limit = (
            vehicle.unknown["yaw_inertia"][1],
            vehicle.roll_inertia + vehicle.pitch_inertia,
        )
        if high > limit:
            doubts.append(
                f"yaw_inertia.range: up to {high:g} kg m^2, but a rigid body needs at most "
                f"roll_inertia + pitch_inertia = {limit:g}"
            )
    loads = vehicle.static_loads()
    for wheel, load in zip(("left", "right", "rear"), loads, strict=True):
        if load <= 0:
            doubts.append(f"{wheel} wheel: carries {load:.1f} N at rest: the vehicle tips over")
        if load / vehicle.vertical_stiffness > 0.1 * vehicle.tyre_radius:
            doubts.append(
                f"vertical_stiffness: the {wheel} tyre sinks by more than a tenth of its radius"
            )
    wheelbase = vehicle.com_to_front_axle + vehicle.com_to_rear_axle
    # the unstable linear bicycle: see docs/model.md
    lowest = min(vehicle.unknown.get("cornering_stiffness", (vehicle.cornering_stiffness,)))
    understeer = vehicle.com_to_rear_axle * lowest - vehicle.com_to_front_axle * 2 * lowest
    if understeer < 0:
        critical = math.sqrt(2 * lowest**2 * wheelbase**2 / (-understeer * vehicle.mass))
        top = vehicle.motor_no_load_speed * vehicle.tyre_radius
        if critical < top:
            doubts.append(
                f"cornering_stiffness: at {lowest:g} N/rad the vehicle oversteers and is unstable "
                f"from {critical:.1f} m/s, below its top speed of {top:.1f} m/s"
            )
    return doubts
