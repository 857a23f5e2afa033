"""Effects: properties of a real vehicle, its ground and its sensors that its file does not contain.

Plans count them and the identification estimates them beside the parameters, each with a Gaussian
prior of mean 0 (as in the file) that says how large it may be. Most change constants of the
vehicle; the others change its motion, or what is seen of it, in closed form. Slope and wind act on
one drive, the others on all.

The *deviations* are processes in time: by which share the vehicle is faster than the model, how
much more it turns, and by how much the set-point of its speed is higher in the first seconds from
rest. They stand for what no constant can, e.g. a servo or a speed loop of another kind, or boards
that do not see a wheel turn slowly. Their size is estimated, so that they vanish where nothing is
missing.
"""

import dataclasses
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from tricycle_core.errors import VehicleError, hint
from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.registry import PARTS, law_name

SPEED_DEVIATION, TURN_DEVIATION = "speed deviation", "turn deviation"
START_DEVIATION = "start deviation"
SLIP_BY_SPEED = "slip by speed"
SENSOR_FORWARD, SENSOR_LEFT, SENSOR_YAW = "sensor forward", "sensor left", "sensor yaw"
WHEEL_RADIUS = "wheel radius"
TYRE_ROUNDING, ROAD_FRICTION = "tyre rounding", "road friction"
SERVO_DEAD_TIME, DRIVE_DEAD_TIME = "servo dead time", "drive dead time"
STEERING_ZERO, STEERING_GAIN = "steering zero", "steering gain"
OF_SERVO = "servo bandwidth", SERVO_DEAD_TIME, "steering play"
"""Effects of how the steering's angle comes about; none where it is measured."""
SPEED_LOOP = "speed loop"
OF_SPEED_LOOP = SPEED_LOOP, DRIVE_DEAD_TIME
"""Effects of how the wheels' speed comes about; none where it is measured."""
REACH = 4.0  # standard deviations of the prior that an effect may have at most


def option_of(name: str) -> str:
    """Return the name of an effect as `--effects` has it.

    Parameters
    ----------
    name : str
        E.g. "steering zero".
    """
    return name.replace(" ", "-")


@dataclass(frozen=True, eq=False)
class Effect:
    """An effect with the standard deviation of its prior.

    Attributes
    ----------
    name : str
        Name in reports; for `--effects` see `option`.
    unit : str
        Unit of its value; "1": a share of the value in the file.
    std : float
        Standard deviation of the prior, in that unit.
    constants : mapping of str to float
        Change of each constant of the vehicle per unit of the effect.
    parts : mapping of str to str
        Laws that the vehicle needs to have these constants, by part; with the constants at their
        defaults it moves as with its own.
    low, high : float
        Smallest and largest value.
    per_drive : bool
        Whether it has another value in each drive.
    process : bool
        Whether it varies during a drive.
    step : float
        Step of finite differences, in standard deviations of the prior.
    prior_probability : float
        Probability before the drives that it acts.
    """

    name: str
    unit: str
    std: float
    constants: Mapping[str, float] = field(default_factory=dict)
    parts: Mapping[str, str] = field(default_factory=dict)
    low: float = -math.inf
    high: float = math.inf
    per_drive: bool = False
    process: bool = False
    step: float = 0.01
    prior_probability: float = 0.1  # of some fifteen effects, one or two act

    @property
    def option(self) -> str:
        """The name, as `--effects` has it."""
        return option_of(self.name)

    @property
    def rough(self) -> bool:
        """Whether the motion changes by jumps, so that its derivative holds on average only."""
        return self.step > Effect.step


# finite differences of effects by which the gear turns round at another step of the simulation
_COARSE = {"servo_backlash": 0.1}

_PROBABILITIES = {
    TYRE_ROUNDING: 0.8,  # a tyre bends with the third power of its slip, as in Pacejka's formula
    ROAD_FRICTION: 0.3,  # each road has its own
    # hardly anybody has measured these
    **dict.fromkeys(("slip stiffness", "relaxation length", "relaxation length along"), 0.3),
    **dict.fromkeys(("tyre saturation", SLIP_BY_SPEED), 0.02),  # of simulators
}

# by part and law: a law with further constants, with whose defaults the vehicle moves the same
_EXTENDED = {
    ("servo", "second_order"): "geared",
    ("tyre", "linear"): "softened",
}

# name, unit, standard deviation; changes of constants per unit of the effect, of which the first
# set that the vehicle has applies, `None`: by the constant's own value
_OF_CONSTANTS: tuple[tuple[str, str, float, tuple[Mapping[str, float | None], ...]], ...] = (
    (STEERING_ZERO, "rad", 0.02, ({"steering_offset": 1.0},)),
    (STEERING_GAIN, "1", 0.02, ({"steering_scale": 1.0},)),
    ("steering play", "rad", 0.01, ({"servo_backlash": 1.0},)),
    ("servo bandwidth", "1", 0.3, ({"servo_natural_frequency": None},)),
    (WHEEL_RADIUS, "1", 0.01, ({"speed_scale": 1.0},)),
    (
        *(SPEED_LOOP, "1", 0.3),
        ({"speed_gain_proportional": None, "speed_gain_integral": None},),
    ),
    (
        *("centre of mass forward", "m", 0.02),
        (
            {"com_to_front_axle": -1.0, "com_to_rear_axle": 1.0},
            {"front.x": -1.0, "rear.x": -1.0},
        ),
    ),
    ("centre of mass up", "m", 0.02, ({"com_height": 1.0},)),
    ("load sensitivity", "1", 0.5, ({"load_sensitivity": 1.0},)),
    ("slip stiffness", "1", 0.3, ({"slip_stiffness": None},)),
    ("relaxation length", "1", 0.3, ({"lateral_relaxation_length": None},)),
    ("relaxation length along", "1", 0.3, ({"longitudinal_relaxation_length": None},)),
    ("tyre saturation", "1", 1.0, ({"tyre_saturation": 1.0},)),
    (TYRE_ROUNDING, "1", 0.5, ({"tyre_rounding": 1.0},)),
    (ROAD_FRICTION, "1", 0.15, ({"friction_coefficient": None},)),
    (SLIP_BY_SPEED, "1", 0.5, ({"slip_by_speed": 1.0},)),
    ("slope or wind along", "rad", 0.01, ({"road_grade": 1.0},)),
    ("slope or wind across", "rad", 0.01, ({"road_bank": 1.0},)),
)
_OTHERS = (
    Effect(SERVO_DEAD_TIME, "s", 0.02, low=0.0, high=REACH * 0.02, prior_probability=0.5),
    Effect(DRIVE_DEAD_TIME, "s", 0.05, low=0.0, high=REACH * 0.05),
    Effect(SENSOR_FORWARD, "m", 0.03),
    Effect(SENSOR_LEFT, "m", 0.03),
    Effect(SENSOR_YAW, "rad", 0.02),
    Effect(SPEED_DEVIATION, "1", 0.01, per_drive=True, process=True),
    Effect(TURN_DEVIATION, "1/m", 0.001, per_drive=True, process=True),
    Effect(START_DEVIATION, "m/s", 0.03, per_drive=True, process=True),
)
EFFECTS: tuple[str, ...] = tuple(
    option_of(name) for name in (*(row[0] for row in _OF_CONSTANTS), *(e.name for e in _OTHERS))
)
"""Every effect, as `--effects` names it."""


def check_effects(names: Sequence[str]) -> None:
    """Raise an error if a name is not one of an effect.

    Parameters
    ----------
    names : sequence of str
        Names that must be in `EFFECTS`.

    Raises
    ------
    VehicleError
        If a name is not in `EFFECTS`.
    """
    for name in names:
        if name not in EFFECTS:
            raise VehicleError(f"{name!r} is not an effect; {hint(name, EFFECTS)}")


def named_effects(names: str, *, planned: bool = False) -> tuple[str, ...]:
    """Return the names of effects as users list them.

    Parameters
    ----------
    names : str
        Names of effects, separated by commas; or "all" or "none".
    planned : bool
        Whether a plan is to count them, which counts no deviations.

    Raises
    ------
    VehicleError
        If one is none of an effect, or of a deviation and `planned`.
    """
    chosen = {"all": EFFECTS, "none": ()}.get(names, tuple(names.split(",")))
    check_effects(chosen)
    deviations = {e.option for e in _OTHERS if e.process}
    if planned and names != "all" and (uncounted := [n for n in chosen if n in deviations]):
        raise VehicleError(f"{', '.join(uncounted)}: plans count no deviations: leave it out")
    return chosen


def effects_of(vehicle: Vehicle, names: Sequence[str]) -> tuple[Effect, ...]:
    """Return effects on a vehicle; those whose constants are unknown parameters are left out.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle that is simulated or identified.
    names : sequence of str
        Names from `EFFECTS`.

    Raises
    ------
    VehicleError
        If a name is not one of an effect.
    """
    check_effects(names)
    extended = extend(vehicle, _extensions(vehicle))
    found = [
        *(
            _of_constants(vehicle, extended, *row)
            for row in _OF_CONSTANTS
            if option_of(row[0]) in names
        ),
        *(_of_motion(vehicle, e) for e in _OTHERS if e.option in names),
    ]
    return tuple(e for e in found if e is not None)


def _of_constants(
    vehicle: Vehicle,
    extended: Vehicle,
    name: str,
    unit: str,
    std: float,
    choices: Sequence[Mapping[str, float | None]],
) -> Effect | None:
    """An effect on constants; None if the vehicle has none of them, or one of them is unknown."""
    owned = next((c for c in choices if set(c) <= set(extended.values)), None)
    if owned is None or set(owned) & set(vehicle.unknown):
        return None
    change = {c: extended.values[c] if per is None else per for c, per in owned.items()}
    change = {c: per for c, per in change.items() if per}  # a share of 0 changes nothing
    if not change:
        return None
    if name == WHEEL_RADIUS:  # of all tyres
        radii = {c: v for c, v in extended.values.items() if c.endswith("tyre_radius")}
        if set(radii) & set(vehicle.unknown):
            return None
        change |= radii
    low, high = _limits(extended, change, std)
    parts = {} if set(owned) <= set(vehicle.values) else _extensions(vehicle, set(owned))
    return Effect(
        *(name, unit, std, change, parts, low, high),
        per_drive=name.startswith("slope"),
        step=max(_COARSE.get(constant, Effect.step) for constant in owned),
        prior_probability=_PROBABILITIES.get(name, Effect.prior_probability),
    )


def _of_motion(vehicle: Vehicle, effect: Effect) -> Effect | None:
    """An effect that changes no constant; None if an unknown constant stands for it."""
    if effect.name != SERVO_DEAD_TIME:
        return effect
    if "servo_delay" in vehicle.unknown:
        return None
    return dataclasses.replace(effect, low=-vehicle.values.get("servo_delay", 0.0))


def extend(vehicle: Vehicle, parts: Mapping[str, str]) -> Vehicle:
    """Return a vehicle with other laws, and the constants that only these read at their defaults.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with all other constants that these laws read.
    parts : mapping of str to str
        Law of each part.
    """
    return dataclasses.replace(vehicle, parts={**vehicle.parts, **parts}) if parts else vehicle


def with_effects(vehicle: Vehicle, effects: Sequence[Effect]) -> Vehicle:
    """Return a vehicle whose constants that effects change are unknown parameters too.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle without the effects.
    effects : sequence of Effect
        Effects on this vehicle, from `effects_of`.
    """
    if not effects:  # checking a vehicle takes milliseconds, and plans ask for every maneuver
        return vehicle
    for e in effects:
        vehicle = extend(vehicle, e.parts)
    unknown = dict(vehicle.unknown)
    for e in effects:
        for name, change in e.constants.items():
            ends = sorted(vehicle.values[name] + change * end for end in (e.low, e.high))
            unknown[name] = ends[0], ends[1]
    return dataclasses.replace(vehicle, unknown=unknown)


def affected_constants(
    affected: Vehicle,
    names: Iterable[str],
    parameters: FloatArray,
    effects: Sequence[Effect],
    values: Mapping[str, FloatArray],
) -> FloatArray:
    """Return the unknown constants (n, K) of n vehicles with effects.

    Parameters
    ----------
    affected : Vehicle
        Nominal vehicle from `with_effects`, of which K constants are unknown.
    names : iterable of str, length k
        Names of the parameters: the unknown constants of the vehicle without the effects.
    parameters : ndarray of float, shape (n, k)
        Parameters of the vehicles, in their units; the effects change them further.
    effects : sequence of Effect
        Effects on the vehicle.
    values : mapping of str to ndarray of float, shape (n,)
        Value of each effect by its name, in its unit; an effect without a value does not act.
    """
    place = {name: i for i, name in enumerate(affected.unknown)}
    constants = np.tile(affected.nominal_point(), (len(parameters), 1))
    constants[:, [place[name] for name in names]] = parameters
    for e in effects:
        if e.name in values:
            for constant, change in e.constants.items():
                constants[:, place[constant]] += change * values[e.name]
    return constants


def corrected(vehicle: Vehicle, estimates: Mapping[str, float]) -> tuple[Vehicle, frozenset[str]]:
    """Return a vehicle with the estimated effects in its constants, and which are wholly in them.

    Others are left out: those of sensors, the dead time of the drive and deviations, of which the
    vehicle has no constants, and what would make it stiffer than the simulation's steps allow. One
    that takes a constant beyond what any vehicle has acts up to there, and is not named.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle without the effects.
    estimates : mapping of str to float
        Estimates of effects by name, in their units; 0: the effect does not act.
    """
    from tricycle_sim.vehicle import stability  # numba takes time to import

    allowed = max(stability.LIMIT / TICK, stability.fastest_mode(vehicle)[0])
    found, held, acting = vehicle, set[str](), set[str]()
    effects = [e for e in effects_of(vehicle, EFFECTS) if estimates.get(e.name)]
    for e in (*effects, *effects):  # one that makes it too stiff may do so no longer with others
        constants, parts = e.constants, e.parts
        if e.name == SERVO_DEAD_TIME:
            constants, parts = {"servo_delay": 1.0}, _extensions(vehicle, {"servo_delay"})
        more, value = extend(found, parts), estimates[e.name]
        if e.name in acting or not constants or not set(constants) <= set(more.values):
            continue
        wanted = {c: more.values[c] + per * value for c, per in constants.items()}
        possible = {c: float(np.clip(v, *more.bounds(c))) for c, v in wanted.items()}
        more = more.replace(**possible)
        if stability.fastest_mode(more)[0] <= allowed:
            found = more
            acting.add(e.name)
            if np.allclose([*possible.values()], [*wanted.values()]):
                held.add(e.name)
    return found, frozenset(held)


def as_sensed(
    x: FloatArray, y: FloatArray, heading: FloatArray, effects: Mapping[str, FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return positions and headings as the sensors would measure them.

    Parameters
    ----------
    x, y, heading : ndarray of float, shape (n, t)
        True positions [m] and headings [rad].
    effects : mapping of str to ndarray of float, shape (n,)
        Values of effects by name; only those of sensors are used.
    """
    values = {name: value[:, None] for name, value in effects.items()}
    if SENSOR_FORWARD in values or SENSOR_LEFT in values:
        forward, left = (values.get(name, np.zeros(1)) for name in (SENSOR_FORWARD, SENSOR_LEFT))
        cosine, sine = np.cos(heading), np.sin(heading)
        x, y = x + forward * cosine - left * sine, y + forward * sine + left * cosine
    if SENSOR_YAW in values:
        heading = heading + values[SENSOR_YAW]
    return x, y, heading


def _extensions(vehicle: Vehicle, constants: Collection[str] | None = None) -> dict[str, str]:
    """Laws that add constants to a vehicle, by part: all, or those that add one of these."""
    found = {}
    for (part, law), other in _EXTENDED.items():
        has_own = any(entry.endswith(f".{part}") for entry in vehicle.parts)
        added = {c.name for c in PARTS[part][other].constants} - set(vehicle.values)
        if (
            law_name(part, vehicle.wheels, vehicle.parts) == law
            and not has_own
            and (constants is None or added & set(constants))
        ):
            found[part] = other
    return found


def _limits(vehicle: Vehicle, change: Mapping[str, float], std: float) -> tuple[float, float]:
    """Values of an effect with which the constants stay possible, and positive ones stay so."""
    low, high = -REACH * std, REACH * std
    for name, per in change.items():
        value, (least, most) = vehicle.values[name], vehicle.bounds(name)
        if least == 0.0 and value > 0.0:
            least = 0.2 * value
        ends = sorted(((least - value) / per, (most - value) / per))
        low, high = max(low, ends[0]), min(high, ends[1])
    return low, high
