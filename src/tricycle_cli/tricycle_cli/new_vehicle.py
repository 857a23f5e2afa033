"""A first vehicle file: from some twenty answers, or from another vehicle's file.

What the answers do not say is estimated, and the entry says from what: it is to be replaced by what
is measured or identified.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from tricycle_core.errors import VehicleError
from tricycle_core.supplies import SUPPLY_LIMIT
from tricycle_sim.vehicle import actuators, body, load_vehicle, steering, tyre, vehicle_document
from tricycle_sim.vehicle.constants import constant_entries
from tricycle_sim.vehicle.laws import Constant, Law
from tricycle_sim.vehicle.registry import PARTS
from tricycle_sim.vehicle.wheels import AXLES, Wheel

LAYOUTS: Mapping[str, Mapping[str, tuple[str, ...]]] = {
    "tadpole": {"front": ("left", "right"), "rear": ("rear",)},
    "delta": {"front": ("front",), "rear": ("left", "right")},
    "car": {"front": ("front_left", "front_right"), "rear": ("rear_left", "rear_right")},
}
"""Names of the wheels by layout and axle."""

GRAVITY = 9.81  # m/s^2

Answers = Mapping[str, Any]
"""Answer by the key of its question."""


@dataclass(frozen=True)
class Question:
    """Question for a value that every vehicle file needs.

    Attributes
    ----------
    key : str
        Key of the answer.
    text : str
        Text of the question, with the unit.
    default : str
        Answer if the line is empty; empty: there is no default.
    low, high : float
        Bounds of a number.
    choices : tuple of str
        Possible answers if it is not a number; empty: any text where `low` is not below `high`.
    asked : callable
        Whether the question is asked, given the answers so far.
    like : str
        Key of an earlier answer, which is then the default.
    """

    key: str
    text: str
    default: str = ""
    low: float = 0.0
    high: float = 0.0
    choices: tuple[str, ...] = ()
    asked: Callable[[Answers], bool] = lambda _: True
    like: str = ""

    def read(self, line: str) -> Any:
        """Return the answer in a line.

        Parameters
        ----------
        line : str
            Line that was typed.

        Raises
        ------
        VehicleError
            If it is not an answer; the message says what would be one.
        """
        line = line.strip()
        if self.choices:
            if line not in self.choices:
                raise VehicleError(f"{line!r}: must be one of {', '.join(self.choices)}")
            return line
        if not self.low < self.high:
            if not (line and line.isprintable()):
                raise VehicleError("needs a printable text")
            return line
        try:
            value = float(line)
        except ValueError:
            raise VehicleError(f"{line!r}: needs a number") from None
        if not self.low <= value <= self.high:
            raise VehicleError(f"{line}: must be between {self.low:g} and {self.high:g}")
        return value


def _wheels(answers: Answers) -> tuple[Wheel, ...]:
    return tuple(
        Wheel(name, axle, steered=axle == answers["steered"], driven=driven, braked=driven)
        for axle, names in LAYOUTS[answers["layout"]].items()
        for driven in [answers["driven"] in (axle, "all")]
        for name in names
    )


def _pair(axle: str) -> Callable[[Answers], bool]:
    return lambda answers: len(LAYOUTS[answers["layout"]][axle]) == 2


def _has(part: str, law: str) -> Callable[[Answers], bool]:
    return lambda answers: answers[part] == law


def _law(part: str, first: str, what: str = "", **how: Any) -> Question:
    """Return the question for the law of a part, of an axle or of all; the first is offered."""
    laws = tuple(sorted(PARTS[part.rpartition(".")[2]], key=lambda law: law != first))
    text = f"law of the {what or part}: {', '.join(laws)}"
    return Question(part, text, first, choices=laws, **how)


QUESTIONS = (
    Question("name", "name of the vehicle"),
    Question(
        "layout",
        "wheels: tadpole (two in front, one behind), delta (one in front, two behind), "
        "car (two in front, two behind)",
        "tadpole",
        choices=tuple(LAYOUTS),
    ),
    Question("steered", "steered axle: front, rear", "front", choices=AXLES),
    Question("driven", "driven and braked wheels: rear, front, all", "rear",
             choices=("rear", "front", "all")),
    _law("steering", "ackermann", asked=lambda answers: _pair(answers["steered"])(answers)),
    _law("front.tyre", "linear", "front tyres"),
    _law("rear.tyre", "linear", "rear tyres", like="front.tyre"),
    _law("servo", "second_order"),
    _law("motor", "hub_motor"),
    Question("mass", "mass with everything on it / kg", low=0.1, high=5000.0),
    Question("wheelbase", "distance of the axles / m", low=0.05, high=10.0),
    Question("front_track", "distance of the front wheels / m", low=0.02, high=5.0,
             asked=_pair("front")),
    Question("rear_track", "distance of the rear wheels / m", low=0.02, high=5.0,
             asked=_pair("rear")),
    Question("front_share", "share of the weight on the front axle / %", "50", 1.0, 99.0),
    Question("com_height", "height of the centre of mass / m", low=0.005, high=5.0),
    Question("tyre_radius", "radius of the tyres / m", low=0.01, high=2.0),
    Question("steering_limit", "largest angle of the steering motor, either side / deg", "45",
             0.6, 68.0),
    Question("servo_delay", "dead time of the servo / s", "0.02", 0.0, actuators.LONGEST_DELAY,
             asked=_has("servo", "geared")),
    Question("servo_backlash", "play of the servo's gear, from stop to stop / deg", "0.5", 0.0,
             28.0, asked=_has("servo", "geared")),
    Question("top_speed", "top speed / m/s", "5", 0.1, 60.0),
    Question("motor_torque", "largest torque of the motor, at the wheels / N m", low=0.001,
             high=10000.0),
    Question("setpoint_torque", "torque of the motor per set-point of 1 m/s / N m", low=0.001,
             high=10000.0, asked=_has("motor", "direct_torque")),
    Question("throttle_full_setpoint", "set-point of full throttle / m/s", "5", 0.1, 60.0,
             asked=_has("motor", "throttle_curve")),
    *(
        Question(f"throttle_torque_{percent}", f"torque at {percent} % of the throttle / N m",
                 low=0.0, high=10000.0, asked=_has("motor", "throttle_curve"))
        for percent in (25, 50, 75, 100)
    ),
    Question("battery_voltage", "voltage of the battery / V", "48", 1.0, 1000.0),
)  # fmt: skip
"""Questions in the order in which they are asked."""


def ask(read: Callable[[str], str], say: Callable[[str], None]) -> dict[str, Any]:
    """Return the answers to all questions; one that cannot be understood is asked again.

    Parameters
    ----------
    read : callable
        Shows a prompt and returns the line that was typed.
    say : callable
        Takes what is wrong with an answer.
    """
    answers: dict[str, Any] = {}
    for question in QUESTIONS:
        if not question.asked(answers):
            continue
        offered = answers.get(question.like, question.default)
        prompt = question.text + (f" [{offered}]" if offered else "") + ": "
        while question.key not in answers:
            try:
                answers[question.key] = question.read(read(prompt).strip() or offered)
            except VehicleError as error:
                say(str(error))
    return answers


Entry = Mapping[str, Any]
"""Entry of a constant in a vehicle file."""


def from_answers(answers: Answers) -> str:
    """Return the text of a vehicle file, not validated.

    Parameters
    ----------
    answers : mapping
        Answers by key, from `ask`.
    """
    wheels = _wheels(answers)
    laws = {part: answers[part] for part in PARTS if part in answers}
    tyres = {f"{axle}.tyre": answers[f"{axle}.tyre"] for axle in AXLES}
    if len(set(tyres.values())) == 1:
        tyres = {"tyre": tyres["front.tyre"]}
    parts = {"steering": "parallel"} | tyres | laws
    known = constant_entries(wheels, parts)
    sized = _Sized.of(answers)
    groups = (_body, _places, _tyres, _steering, _motor)
    estimates = (estimate for group in groups for estimate in group(answers, sized))
    entries = {e.name: e.entry(known[e.name].unit) for e in estimates if e.name in known}
    about = f"{answers['layout']}, first file by tricycle vehicle new"
    return _text(answers["name"], about, wheels, parts, entries)


def shipped_vehicles() -> dict[str, Path]:
    """Return the vehicle files that come with the suite, by name."""
    folder = Path(str(resources.files("tricycle_sim")))
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def from_file(source: str, name: str) -> str:
    """Return the text of a vehicle file with the numbers of another one.

    Parameters
    ----------
    source : str
        Path of the other file, or its name in `shipped_vehicles`.
    name : str
        Name of the new vehicle.

    Raises
    ------
    VehicleError
        If the other one is neither a shipped vehicle nor a valid vehicle file.
    """
    shipped = shipped_vehicles()
    path = shipped.get(source, Path(source))
    if not path.exists():
        raise VehicleError(f"{source}: no such file; shipped are {', '.join(shipped)}")
    vehicle = load_vehicle(path)
    about = f"from {vehicle.name} by tricycle vehicle new"
    return _text(name, about, vehicle.wheels, vehicle.parts, vehicle_document(path)["constants"])


class _Estimate(NamedTuple):
    """A constant, and what the number rests on."""

    name: str
    value: float  # SI
    about: str
    basis: str = "argued"
    low: float = 1.0  # of an unknown parameter: share of the value that it may be ...
    high: float = 1.0  # ... at least and at most

    def entry(self, unit: str) -> Entry:
        """Return it as a vehicle file has it; angles in degrees."""
        scale, unit = (180.0 / math.pi, "deg") if unit == "rad" else (1.0, unit)
        low, value, high = (
            float(f"{scale * share * self.value:.4g}") for share in (self.low, 1.0, self.high)
        )
        number = {"nominal": value, "range": [low, high]} if low < high else {"value": value}
        return {**number, "unit": unit, "basis": self.basis, "about": self.about}


class _Sized(NamedTuple):
    """Sizes and loads on which several estimates are based."""

    wheels: tuple[Wheel, ...]
    load: Mapping[str, float]  # N, of each wheel of an axle
    mean_load: float  # N
    track: Mapping[str, float]  # m, by axle; 0 with one wheel

    @classmethod
    def of(cls, answers: Answers) -> _Sized:
        wheels, front = _wheels(answers), 0.01 * answers["front_share"]
        weight = answers["mass"] * GRAVITY
        load = {
            axle: weight * share / sum(wheel.axle == axle for wheel in wheels)
            for axle, share in (("front", front), ("rear", 1.0 - front))
        }
        track = {axle: answers.get(f"{axle}_track", 0.0) for axle in load}
        return cls(wheels, load, weight / len(wheels), track)

    def damping(self, stiffness: float, share: float) -> float:
        """Return a share of the critical damping of the mass on one wheel [N s/m]."""
        return 2.0 * share * math.sqrt(stiffness * self.mean_load / GRAVITY)


_ANSWERED = "the answer to tricycle vehicle new"


def _body(answers: Answers, sized: _Sized) -> Iterator[_Estimate]:
    mass, height = answers["mass"], answers["com_height"]
    length = answers["wheelbase"] + 0.5 * answers["tyre_radius"]
    width, tall = max(sized.track.values()), 1.5 * height
    box = f"a box of {length:.3g} x {width:.3g} x {tall:.3g} m"
    about_yaw = length**2 + width**2
    most = 1.0 + min(0.3, 1.9 * tall**2 / about_yaw)  # a rigid body has no more
    yield _Estimate("gravity", GRAVITY, "standard gravity", "literature")
    yield _Estimate("mass", mass, _ANSWERED, "data")
    yield _Estimate("roll_inertia", mass / 12.0 * (width**2 + tall**2), box)
    yield _Estimate("pitch_inertia", mass / 12.0 * (length**2 + tall**2), box)
    yield _Estimate("yaw_inertia", mass / 12.0 * about_yaw, box, low=0.7, high=most)
    yield _Estimate(
        "air_drag", 1.2 * width * height, "drag coefficient 1, twice as high as the COM"
    )
    yield _Estimate("rollover_angle", math.radians(45.0), "a run ends there as rolled over")


def _places(answers: Answers, sized: _Sized) -> Iterator[_Estimate]:
    front, wheelbase = 0.01 * answers["front_share"], answers["wheelbase"]
    for axle, share in (("front", 1.0 - front), ("rear", front)):
        about = "from the share of the weight on the front axle"
        yield _Estimate(f"com_to_{axle}_axle", share * wheelbase, about, "data")
        names = [wheel.name for wheel in sized.wheels if wheel.axle == axle]
        pair = len(names) == 2
        about = "half the track" if pair else "on the centre line"
        for name, side in zip(names, (0.5, -0.5) if pair else (0.0,), strict=True):
            yield _Estimate(f"{name}.y", side * sized.track[axle], about, "data")
    yield _Estimate("com_height", answers["com_height"], _ANSWERED, "data")
    yield _Estimate("tyre_radius", answers["tyre_radius"], _ANSWERED, "data")
    inertia = 0.8 * 0.04 * answers["mass"] * answers["tyre_radius"] ** 2
    yield _Estimate("wheel_inertia", inertia, "each wheel 4 % of the mass, most of it at the tread")


def _tyres(answers: Answers, sized: _Sized) -> Iterator[_Estimate]:
    radius, load = answers["tyre_radius"], sized.mean_load
    for axle, own in sized.load.items():
        about = "8 per rad of the load; bicycle tyres 4 to 8, car tyres 10 to 15"
        yield _Estimate(f"{axle}.cornering_stiffness", 8.0 * own, about, low=0.5, high=1.5)
        about = "a twentieth of the cornering stiffness"
        yield _Estimate(f"{axle}.camber_stiffness", 0.4 * own, about)
    yield _Estimate("self_aligning_stiffness", 0.0, "not known, small")
    yield _Estimate("rolling_coefficient_1", 0.01, "pneumatic tyres on asphalt", "literature")
    yield _Estimate("rolling_coefficient_2", 0.0, "small at low speed")
    # less would be too stiff for steps of 10 ms
    sink = max(0.015 * radius, 0.0013)
    vertical = load / sink
    yield _Estimate("vertical_stiffness", vertical, f"sinks by {1e3 * sink:.2g} mm at rest")
    yield _Estimate("vertical_damping", sized.damping(vertical, 0.15), "lightly damped")
    yield _Estimate("friction_coefficient", 0.8, "rubber on dry asphalt", "literature")
    yield _Estimate("friction_load_slope", 0.1, "falls a little with the load", "literature")
    yield _Estimate("load_sensitivity", 0.0, "0: stiffness per wheel; 1: proportional to the load")
    yield _Estimate("slip_stiffness", 15.0 * load, "15 times the load")
    along, aside = max(0.3 * radius, 0.05), max(0.6 * radius, 0.1)
    yield _Estimate("longitudinal_relaxation_length", along, "half the lateral one")
    yield _Estimate("lateral_relaxation_length", aside, "0.6 of the radius, 0.1 m at least")
    yield _Estimate("slip_speed_floor", 0.1, "keeps the slips finite at standstill")
    yield _Estimate("carcass_damping_speed", 0.5, "the carcass damping fades out above it")
    carcass = sized.damping(15.0 * load / along, 0.035), sized.damping(8.0 * load / aside, 0.1)
    about = "damps the tyre springs near standstill"
    yield _Estimate("longitudinal_carcass_damping", carcass[0], about)
    yield _Estimate("lateral_carcass_damping", carcass[1], about)
    yield _Estimate("rolling_smoothing_speed", 0.05, "the rolling resistance changes sign over it")
    for name, shape in (("longitudinal", 1.6), ("lateral", 1.3)):
        yield _Estimate(f"shape_{name}", shape, "typical of car tyres", "literature")
        yield _Estimate(f"curvature_{name}", 0.0, "typical of car tyres", "literature")


def _steering(answers: Answers, _: _Sized) -> Iterator[_Estimate]:
    limit = math.radians(answers["steering_limit"])
    yield _Estimate("caster_angle", 0.0, "not known")
    yield _Estimate("steering_limit", limit, _ANSWERED, "data")
    yield _Estimate("steering_ratio_straight", 0.95, "outer to inner wheel near straight ahead")
    yield _Estimate("steering_ratio_full", 0.75, "outer to inner wheel at the limit")
    about = "over it inner and outer wheel change places"
    yield _Estimate("steering_ratio_smoothing", math.radians(2.0), about)
    yield _Estimate("servo_natural_frequency", 25.0, "position loop of a hobby servo")
    yield _Estimate("servo_damping_ratio", 0.9, "hardly any overshoot")
    if answers["servo"] == "geared":
        yield _Estimate("servo_delay", answers["servo_delay"], _ANSWERED, "data")
        backlash = math.radians(answers["servo_backlash"])
        yield _Estimate("servo_backlash", backlash, _ANSWERED, "data")
    about = "of the steer PLC's set-point: {:.3g} deg/s; its hard limit is 3 rad/s"
    yield _Estimate("steering_slew", 2.0, about.format(math.degrees(2.0)))


def _motor(answers: Answers, _: _Sized) -> Iterator[_Estimate]:
    mass, radius, torque = (answers[key] for key in ("mass", "tyre_radius", "motor_torque"))
    no_load = 1.15 * answers["top_speed"] / radius
    gain = 3.0 * 1.2 * mass * radius**2  # the wheels' inertia is a fifth of all
    voltage = answers["battery_voltage"]
    yield _Estimate("acceleration", 1.0, "of the drive PLC's set-point; its hard limit is 2")
    yield _Estimate("motor_torque", torque, _ANSWERED, "data")
    yield _Estimate("motor_power", 0.5 * torque * no_load, "half of torque times no-load speed")
    yield _Estimate("regenerative_torque", 0.4 * torque, "0.4 of the driving torque")
    yield _Estimate("motor_no_load_speed", no_load, "15 % above the top speed")
    yield _Estimate("motor_slope", 4.0 * torque / no_load, "torque falls over the last quarter")
    yield _Estimate("motor_lag", 0.03, "current loop and commutation")
    yield _Estimate("motor_copper_loss", 50.0 / torque**2, "50 W at the largest torque")
    yield _Estimate("battery_voltage", voltage, _ANSWERED, "data")
    low = min(0.85 * voltage, SUPPLY_LIMIT)
    yield _Estimate("drive_supply_low", low, "the boards do not arm below")
    yield _Estimate("speed_gain_proportional", gain, "speed loop of about 3 rad/s")
    yield _Estimate("speed_gain_integral", gain, "speed loop of about 3 rad/s")
    yield _Estimate("speed_anti_windup", 4.0 / gain, "back-calculation gain of the integrator")
    for name, answer in answers.items():
        if name.startswith(("setpoint_", "throttle_")):
            yield _Estimate(name, answer, _ANSWERED, "data")
    yield _Estimate("brake_torque", 0.2 * mass * GRAVITY * radius, "brakes with 2 m/s^2")
    yield _Estimate("brake_smoothing_speed", 0.5, "the brake's torque changes sign over it")


# ---- text ----

_HEADER = """\
# Check it, and look at it from above, with: tricycle vehicle check FILE --draw PICTURE
#
# value            a known constant, in the unit beside it (angles in rad or deg)
# nominal, range   an unknown parameter: what the planner varies and identification estimates
# basis            data, literature, argued (our choice), interpreted (our reading)
#
# A wheel or an axle may have its own: front.cornering_stiffness, {wheel}.tyre_radius.
"""


def _of_laws(laws: Mapping[str, Law]) -> Iterator[Constant]:
    return (constant for law in laws.values() for constant in law.constants)


_PLACES = "wheels; from the centre of mass: x forward, y left, z up"
_BY_HEADING = {
    "body": body.BODY_CONSTANTS,
    _PLACES: (),
    "tyres": (*tyre.CONSTANTS, *_of_laws(tyre.LAWS)),
    "steering": (
        *(*steering.CONSTANTS, *actuators.STEERING_SLEW),
        *(*_of_laws(steering.LINKAGES), *_of_laws(actuators.SERVOS)),
    ),
    "motor, battery and brake": (
        *(*actuators.DRIVE_SLEW, *_of_laws(actuators.MOTORS)),
        *(*_of_laws(actuators.DRIVES), *_of_laws(actuators.BRAKES)),
    ),
    "road": body.ROAD_CONSTANTS,
}


def _heading(entry: str) -> str:
    """Return the heading under which a constant stands."""
    plain = entry.rpartition(".")[2]
    return next(
        (
            heading
            for heading, constants in _BY_HEADING.items()
            if any(constant.name == plain for constant in constants)
        ),
        _PLACES,
    )


def _text(
    name: str,
    about: str,
    wheels: tuple[Wheel, ...],
    parts: Mapping[str, str],
    entries: Mapping[str, Entry],
) -> str:
    lines = [_HEADER.format(wheel=wheels[0].name), f"name: {_flow(name)}", f"about: {_flow(about)}"]
    lines.append("wheels:")
    for wheel in wheels:
        roles = {role: True for role in ("steered", "driven", "braked") if getattr(wheel, role)}
        lines.append(f"  - {_flow({'name': wheel.name, 'axle': wheel.axle, **roles})}")
    laws = ", ".join(f"{part}: {' or '.join(choices)}" for part, choices in PARTS.items())
    lines += [f"# laws, the default unless one is named; {laws}", f"parts: {_flow(dict(parts))}"]
    lines.append("constants:")
    heading = ""
    for entry in sorted(entries, key=lambda entry: list(_BY_HEADING).index(_heading(entry))):
        if _heading(entry) != heading:
            heading = _heading(entry)
            lines += ["", f"  # {heading}"]
        lines.append(f"  {entry}: {_flow(entries[entry])}")
    known = constant_entries(wheels, parts)
    optional = [c for c in known.values() if c.default is not None and c.name not in entries]
    if optional:
        lines += ["", "  # may be left out, then with these values"]
        for constant in optional:
            given = {"value": constant.default, "unit": constant.unit}
            lines.append(f"  # {constant.name}: {_flow(given)}")
    return "\n".join(lines) + "\n"


def _flow(value: object) -> str:
    text: str = yaml.safe_dump(
        value, default_flow_style=True, sort_keys=False, allow_unicode=True, width=math.inf
    )
    return text.removesuffix("\n").removesuffix("\n...").removesuffix("\n")
