"""The constants of a tricycle, each with its unit and its bounds.

Everything that the model of `docs/model.md` needs is one number of a `Vehicle`, in SI units.
Letters of array shapes: `n` samples, `k` unknown parameters, `t` time points.
"""

import dataclasses
import difflib
import hashlib
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tricycle_core.errors import VehicleError
from tricycle_core.quantities import FloatArray
from tricycle_core.supplies import DRIVE_SUPPLY_THRESHOLDS, STEER_SUPPLY_THRESHOLDS

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
"""The constants that a vehicle file may leave unknown, in their order everywhere.

Any constant of `tricycle_sim.vehicle.parts.group_constants` can be listed here.
"""


def _constant(
    unit: str, *, low: float = 0.0, high: float = math.inf, zero: bool = False
) -> dict[str, Any]:
    """Metadata of a field: its unit and its interval, which excludes `low` unless `zero`."""
    return {"unit": unit, "low": low, "high": high, "zero": zero}


def _positive(unit: str, default: Any = dataclasses.MISSING) -> float:
    value: float = field(default=default, metadata=_constant(unit))
    return value


def _not_negative(unit: str) -> float:
    value: float = field(metadata=_constant(unit, zero=True))
    return value


def _between(unit: str, low: float, high: float, default: Any = dataclasses.MISSING) -> float:
    metadata = _constant(unit, low=low, high=high, zero=True)
    value: float = field(default=default, metadata=metadata)
    return value


def _any(unit: str) -> float:
    value: float = field(metadata=_constant(unit, low=-math.inf))
    return value


@dataclass(frozen=True, kw_only=True)
class Vehicle:
    """A tricycle (two steered wheels in front, one driven behind), validated on creation.

    Body frame at the centre of mass (COM): x forward, y left, z up (REP-103). The
    `UNKNOWN_PARAMETERS` hold their nominal values; those listed in `unknown` are uncertain. The
    road is a plane, level by default; the world's frame lies in it.

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
    steering_limit: float = _between("rad", 0.01, 1.2)  # of the motor: its end stop
    steering_margin: float = _between("1", 0.0, 0.5, 0.05)  # of the limit, kept free by plans
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
    # the boards' supplies, outside of which they do not arm; 0: not checked
    drive_supply_low: float = _between("V", 0.0, 60.0, DRIVE_SUPPLY_THRESHOLDS[0])
    drive_supply_high: float = _between("V", 0.0, 60.0, DRIVE_SUPPLY_THRESHOLDS[1])
    steer_supply_low: float = _between("V", 0.0, 60.0, STEER_SUPPLY_THRESHOLDS[0])
    steer_supply_high: float = _between("V", 0.0, 60.0, STEER_SUPPLY_THRESHOLDS[1])
    speed_gain_proportional: float = _positive("N m s/rad")
    speed_gain_integral: float = _not_negative("N m/rad")
    speed_anti_windup: float = _not_negative("rad/(N m s)")
    brake_torque: float = _not_negative("N m")
    brake_smoothing_speed: float = _positive("rad/s")
    # road: a plane, whose frame is the world's of all trajectories
    road_grade: float = _between("rad", -0.5, 0.5, 0.0)  # of the x axis above the horizontal
    road_bank: float = _between("rad", -0.5, 0.5, 0.0)  # of the y axis above the horizontal
    # what is not known
    unknown: Mapping[str, tuple[float, float]]
    # laws other than the first of `tricycle_sim.vehicle.parts.PARTS`, by part
    parts: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for constant in constant_fields():
            _check_value(constant.name, getattr(self, constant.name), constant.metadata)
        units = {constant.name: constant.metadata for constant in constant_fields()}
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
    def steering_reach(self) -> float:
        """Largest angle of the steering motor in a plan [rad]: the margin before its end stop."""
        return self.steering_limit * (1.0 - self.steering_margin)

    @property
    def fingerprint(self) -> str:
        """Sixteen hexadecimal digits that change with any value, range or law of the vehicle."""
        values = {
            constant.name: getattr(self, constant.name)
            for constant in constant_fields()
            if getattr(self, constant.name) != constant.default
        }
        content = [values, dict(self.unknown), dict(self.parts)]
        text = json.dumps(content if self.parts else content[:2])
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    def nominal_point(self) -> FloatArray:
        """Nominal values of the unknown parameters, shape (k,)."""
        return np.array(list(self.nominal.values()))

    def static_loads(self) -> tuple[float, float, float]:
        """Wheel loads left, right, rear at rest [N], by moment balance of the rigid vehicle.

        It heads +x, held by its tyres where the road is not level.
        """
        x, y, z = (self.mass * self.gravity * part for part in upward(self))
        wheelbase = self.com_to_front_axle + self.com_to_rear_axle
        rear = (z * self.com_to_front_axle + x * self.com_height) / wheelbase
        front = z - rear
        track = self.left_wheel_y - self.right_wheel_y
        left = (
            -(front * self.right_wheel_y + rear * self.rear_wheel_y + y * self.com_height) / track
        )
        return left, front - left, rear

    def replace(self, **values: float) -> "Vehicle":
        """Return the vehicle with other values.

        Parameters
        ----------
        **values : float
            By the constant's name, in its unit; of an unknown parameter the nominal value.

        Raises
        ------
        VehicleError
            If a name is no constant of a vehicle or a value is out of its range.
        """
        names = [constant.name for constant in constant_fields()]
        for name in values:
            if name not in names:
                raise VehicleError(
                    f"{name}: is no constant of a vehicle; {suggest_name(name, names)}"
                )
        return dataclasses.replace(self, **values)  # type: ignore[arg-type]


def constant_fields() -> list[dataclasses.Field[Any]]:
    """Return the fields of `Vehicle` that are numbers; metadata: unit, low, high, zero.

    A constant with a default may be missing from a vehicle file.
    """
    return [entry for entry in dataclasses.fields(Vehicle) if "unit" in entry.metadata]


def upward(values: Any) -> tuple[Any, Any, Any]:
    """Return the upward vertical in the road's frame, a unit vector.

    Parameters
    ----------
    values : object
        With `road_grade` and `road_bank` as attributes; numbers or arrays.
    """
    x, y = np.sin(values.road_grade), np.sin(values.road_bank)
    return x, y, np.sqrt(1.0 - x * x - y * y)


def draw_truth(vehicle: Vehicle, rng: np.random.Generator) -> dict[str, float]:
    """Return values of the unknown parameters by name, uniform in their ranges.

    Parameters
    ----------
    vehicle : Vehicle
        With the ranges.
    rng : Generator
        Source of the values.
    """
    return {name: float(rng.uniform(low, high)) for name, (low, high) in vehicle.unknown.items()}


def suggest_name(name: str, names: list[str]) -> str:
    """Return a hint at what was meant by a wrong name.

    Parameters
    ----------
    name : str
        The wrong one.
    names : list of str
        The right ones.
    """
    close = difflib.get_close_matches(name, names, n=1)
    return f"did you mean {close[0]}?" if close else "see tricycle.yaml for the names"


def _check_value(where: str, value: float, metadata: Mapping[str, Any]) -> None:
    low, high, zero = metadata["low"], metadata["high"], metadata["zero"]
    inside = (low <= value if zero else low < value) and value <= high and math.isfinite(value)
    if not inside:
        bounds = f"{'[' if zero else '('}{low:g}, {high:g}]"
        raise VehicleError(f"{where}: {value:g} {metadata['unit']} is not in {bounds}")
