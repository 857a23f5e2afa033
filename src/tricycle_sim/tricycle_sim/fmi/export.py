"""Our vehicle as an FMU 2.0 for co-simulation, with a binary that needs no Python.

FMI: Functional Mock-up Interface for Model Exchange and Co-Simulation, version 2.0.4.
"""

import hashlib
import re
import shutil
import subprocess
import tempfile
import zipfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from tricycle_core import __version__
from tricycle_core.documents import write_whole
from tricycle_core.errors import VehicleError
from tricycle_core.timing import TICK
from tricycle_sim.fmi.expressions import Expression, c_text, literal
from tricycle_sim.fmi.machine_code import object_file
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.body import BODY
from tricycle_sim.vehicle.constants import constant_entries
from tricycle_sim.vehicle.layout import (
    ALIVE,
    EVALUATED,
    EVENT,
    EVENT_ROWS,
    LANES,
    SLOPE,
    STATE,
    WHEEL_EVALUATED,
    WHEEL_STATES,
)
from tricycle_sim.vehicle.parts import (
    BLOCK,
    ROWS,
    WHEEL,
    WHEEL_ROWS,
    group_constants,
    servo_at_rest,
    steering_constants,
    structure_of,
)
from tricycle_sim.vehicle.registry import wheel_values
from tricycle_sim.vehicle.stability import check_step

COMPILER = "gcc"
_FIRST_OUTPUT, _FIRST_PARAMETER = 100, 1000  # value references
_CAMBER = "camber_stiffness"  # set aside where the vehicle stands, as `groups.equilibrium` does
_INPUTS = (
    ("steering_setpoint", "rad", "of the steering motor; slewed by steering_slew"),
    ("speed_setpoint", "m/s", "of the driven wheels' tread; slewed by acceleration"),
    ("torque_setpoint", "N m", "of the motor, in torque_mode"),
    ("brake", "1", "share 0 to 1 of the friction brake"),
)
_OUTPUTS = (
    ("x", "m", "of the centre of mass"),
    ("y", "m", "of the centre of mass"),
    ("z", "m", "of the centre of mass"),
    ("heading", "rad", "not wrapped"),
    ("roll", "rad", "ZYX angle"),
    ("pitch", "rad", "ZYX angle, positive: nose down"),
    ("vx", "m/s", "forward, of the centre of mass, body frame"),
    ("vy", "m/s", "to the left, of the centre of mass, body frame"),
    ("yaw_rate", "rad/s", "body frame"),
    ("ax", "m/s^2", "forward, as an accelerometer reads"),
    ("ay", "m/s^2", "to the left, as an accelerometer reads"),
    ("steering_motor_angle", "rad", ""),
    ("steering_motor_rate", "rad/s", ""),
    ("drive_speed", "rad/s", "of the motor: mean of the driven wheels"),
    ("drive_angle", "rad", "turned by the motor since the start"),
    ("drive_torque", "N m", "of the motor"),
)
_STARTS = (
    ("start_x", "m"),
    ("start_y", "m"),
    ("start_heading", "rad"),
    ("start_speed", "m/s"),
    ("start_speed_setpoint", "m/s"),
)
_BASE_UNITS = {
    "kg": {"kg": 1},
    "m": {"m": 1},
    "s": {"s": 1},
    "A": {"A": 1},
    "rad": {"rad": 1},
    "N": {"kg": 1, "m": 1, "s": -2},
    "W": {"kg": 1, "m": 2, "s": -3},
    "V": {"kg": 1, "m": 2, "s": -3, "A": -1},
}


@dataclass(frozen=True)
class _Variable:
    name: str
    reference: int
    causality: str
    unit: str
    about: str = ""
    start: float | None = None


def export_fmu(vehicle: Vehicle, output: Path) -> tuple[str, ...]:
    """Write a vehicle as an FMU 2.0 for co-simulation on 64-bit Linux.

    Its inputs are the boards' set-points, before slewing unless `slewed` is set. Parameters are all
    constants but those of the steering and the boards, which are compiled in. It moves in steps of
    10 ms, one Runge-Kutta step each, as batches do.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle whose wheels touch the ground.
    output : Path
        File to write.

    Returns
    -------
    tuple of str
        Unknown parameters of the vehicle that are no parameters of the FMU.

    Raises
    ------
    VehicleError
        If the vehicle is too stiff for the steps, or there is no C compiler.
    """
    check_step(vehicle, TICK)
    compiler = shutil.which(COMPILER)
    if compiler is None:
        raise VehicleError(f"an FMU needs the compiler {COMPILER}, and there is none on the path")
    variables = _variables(vehicle)
    identifier = re.sub(r"\W", "_", vehicle.name, flags=re.ASCII)  # a name in C
    if identifier[:1].isdigit():
        identifier = f"_{identifier}"
    header = _header(vehicle, variables)
    source = (Path(__file__).parent / "fmu.c").read_text(encoding="utf-8")
    guid = hashlib.sha256(f"{header}{source}{identifier}{__version__}".encode()).hexdigest()
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        (place / "vehicle.h").write_text(f'{header}#define GUID "{guid}"\n', encoding="utf-8")
        (place / "fmu.c").write_text(source, encoding="utf-8")
        (place / "vehicle.o").write_bytes(object_file(vehicle))
        command = f"{compiler} -std=gnu11 -O2 -fPIC -shared -fvisibility=hidden".split()
        command += ["-Wl,--no-undefined", "-Wl,-z,noexecstack", "-o", f"{identifier}.so"]
        made = subprocess.run(  # noqa: S603 - our own source
            [*command, "fmu.c", "vehicle.o", "-lm"], cwd=place, capture_output=True, text=True
        )
        if made.returncode:
            lines = made.stderr.strip().splitlines() or ["no message"]
            raise VehicleError(f"{output}: {COMPILER} failed: {lines[-1]}")
        whole = place / "whole.fmu"
        with zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr(
                "modelDescription.xml", _description(vehicle, identifier, guid, variables)
            )
            archive.write(place / f"{identifier}.so", f"binaries/linux64/{identifier}.so")
        try:
            write_whole(output, whole.read_bytes())
        except OSError as error:
            raise VehicleError(f"{output}: cannot be written: {error.strerror}") from None
    names = {variable.name for variable in variables}
    return tuple(name for name in vehicle.unknown if name not in names)


def fmu_parameters(vehicle: Vehicle) -> tuple[str, ...]:
    """Return the constants that are parameters of a vehicle's FMU.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle; its wheels and laws are used.
    """
    entries = constant_entries(vehicle.wheels, vehicle.parts)
    steering = steering_constants(vehicle, TICK)

    def steers(name: str) -> bool:
        constant = entries[name]
        moved = vehicle.values[name] * 1.001 + 1e-3 * (vehicle.values[name] == 0.0)
        changed = steering_constants(vehicle, TICK, {**vehicle.values, name: moved})
        return constant.setting or not (changed == steering).all()

    fixed = {"steering_slew", "acceleration", "battery_voltage", "motor_copper_loss"}
    return tuple(name for name in vehicle.values if name not in fixed and not steers(name))


def _variables(vehicle: Vehicle) -> list[_Variable]:
    found = [
        _Variable(name, number, "input", unit, about, 0.0)
        for number, (name, unit, about) in enumerate(_INPUTS)
    ]
    outputs = [
        *_OUTPUTS,
        *((f"wheel_speed_{wheel.name}", "rad/s", "") for wheel in vehicle.wheels),
        *((f"load_{wheel.name}", "N", "") for wheel in vehicle.wheels),
    ]
    found += [
        _Variable(name, number, "output", unit, about)
        for number, (name, unit, about) in enumerate(outputs, start=_FIRST_OUTPUT)
    ]
    number = _FIRST_PARAMETER
    for name in fmu_parameters(vehicle):
        unit, value = vehicle.unit(name), vehicle.values[name]
        found.append(_Variable(name, number, "parameter", unit, "", value))
        number += 1
    for name, unit in _STARTS:
        found.append(_Variable(name, number, "parameter", unit, "at the start", 0.0))
        number += 1
    return found


def _header(vehicle: Vehicle, variables: list[_Variable]) -> str:
    """Return what `fmu.c` includes."""
    parameters = [v for v in variables if v.causality == "parameter"]
    index = {v.name: number for number, v in enumerate(parameters)}
    values = dict(vehicle.values)
    traced = values | {
        name: Expression(f"p[{number}]") for name, number in index.items() if name in values
    }
    structure = structure_of(vehicle)
    each = wheel_values(vehicle.wheels, traced, vehicle.declared)
    driven = next(number for number, wheel in enumerate(vehicle.wheels) if wheel.driven)
    stiffness = sum(own.vertical_stiffness for own in each)
    height = traced["com_height"] - traced["mass"] * traced["gravity"] / stiffness
    body = [*BODY]
    numbers = {
        "TICK": literal(TICK),
        "LANES": LANES,
        "GROUP": ROWS * LANES,
        "WHEELS": len(vehicle.wheels),
        "WHEEL_STATES": WHEEL_STATES,
        "WHEEL_ROWS": WHEEL_ROWS,
        "WHEEL_EVALUATED": WHEEL_EVALUATED,
        "EVENT_ROWS": EVENT_ROWS,
        "INPUTS": len(_INPUTS),
        "OUTPUTS": sum(v.causality == "output" for v in variables),
        "PARAMETERS": len(parameters),
        "FIRST_OUTPUT": _FIRST_OUTPUT,
        "FIRST_PARAMETER": _FIRST_PARAMETER,
        "SERVO_SIZE": len(servo_at_rest(vehicle)),
        "DRIVEN": driven,
        "STEERING_SLEW": literal(vehicle.steering_slew),
        "ACCELERATION": literal(vehicle.acceleration),
        **{name.upper(): number for number, (name, _, _) in enumerate(_INPUTS)},
        **{name.upper(): index[name] for name, _ in _STARTS},
        **{f"ROW_{row.upper()}": getattr(STATE, row) for row in STATE._fields if row in _ROWS},
        "ROW_SLOPE_U": SLOPE + STATE.u,
        "ROW_LOAD": EVALUATED.load,
        "ROW_ALIVE": ALIVE,
        "ROW_LEAST_LOAD": EVENT.least_load,
        "ROW_TORQUE_SHARE": WHEEL.torque_share,
        **{
            f"ROW_{row.upper()}": BLOCK.body + body.index(row)
            for row in ("gravity_x", "gravity_y", "gravity_z")
        },
        "STEERING_CONSTANTS": _braces(map(literal, steering_constants(vehicle, 0.5 * TICK))),
        "SIDES": _braces(map(str, structure.sides)),
        "PARAMETER_STARTS": _braces(literal(v.start or 0.0) for v in parameters),
    }
    lines = [f"#define {name} {value}" for name, value in numbers.items()]
    lines += ["static void vehicle_constants(const double *p, double *g) {"]
    lines += ["    for (int i = 0; i < LANES; ++i) {"]
    for row, value in group_constants(vehicle, traced).items():
        lines.append(f"        g[{row} * LANES + i] = {c_text(value)};")
    lines += ["    }", "}", "static void set_aside(double *p) {", "    (void)p;"]
    lines += [
        f"    p[{number}] = 0.0;"
        for name, number in index.items()
        if name.rpartition(".")[2] == _CAMBER
    ]
    lines += ["}", "static double first_height(const double *p) {"]
    lines += [f"    return {c_text(height)};", "}"]
    lines += ["static double wheel_radius(const double *p, int wheel) {", "    switch (wheel) {"]
    lines += [
        f"    case {number}: return {c_text(own.tyre_radius)};" for number, own in enumerate(each)
    ]
    lines += ["    }", "    return p[0];", "}"]
    return "\n".join(lines) + "\n"


_ROWS = {"x", "y", "z", "q0", "u", "p", "q", "r", "torque", "integrator", "spin"}


def _braces(items: Iterable[str]) -> str:
    return "{" + ", ".join(items) + "}"


def _exponents(unit: str) -> dict[str, int]:
    """Return the exponents of the base units in a unit like `W/(N m)^2`."""
    found: dict[str, int] = {}
    above, _, below = unit.partition("/")
    for text, sign in ((above, 1), (below, -1)):
        whole = re.fullmatch(r"\((.*)\)(?:\^(\d+))?", text)
        inner, power = (whole[1], int(whole[2] or 1)) if whole else (text, 1)
        for name, exponent in re.findall(r"([A-Za-z]+)(?:\^(\d+))?", inner):
            for base, number in _BASE_UNITS[name].items():
                found[base] = found.get(base, 0) + sign * power * number * int(exponent or 1)
    return {base: number for base, number in found.items() if number}


def _description(vehicle: Vehicle, identifier: str, guid: str, variables: list[_Variable]) -> bytes:
    """Return modelDescription.xml."""
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=vehicle.name,
        guid=guid,
        version=vehicle.fingerprint,
        generationTool=f"tricycle-excitation {__version__}",
        variableNamingConvention="structured",
        numberOfEventIndicators="0",
    )
    ElementTree.SubElement(
        root,
        "CoSimulation",
        modelIdentifier=identifier,
        canHandleVariableCommunicationStepSize="false",
        canBeInstantiatedOnlyOncePerProcess="false",
    )
    units = ElementTree.SubElement(root, "UnitDefinitions")
    for unit in dict.fromkeys(v.unit for v in variables):
        entry = ElementTree.SubElement(units, "Unit", name=unit)
        exponents = {base: str(number) for base, number in _exponents(unit).items()}
        ElementTree.SubElement(entry, "BaseUnit", exponents)
    ElementTree.SubElement(
        root, "DefaultExperiment", startTime="0", stopTime="10", stepSize=repr(TICK)
    )
    listed = ElementTree.SubElement(root, "ModelVariables")
    outputs = []
    for number, variable in enumerate(variables, start=1):
        attributes = {
            "name": variable.name,
            "valueReference": str(variable.reference),
            "causality": variable.causality,
            "variability": "fixed" if variable.causality == "parameter" else "continuous",
        }
        real = {"unit": variable.unit}
        if variable.about:
            attributes["description"] = variable.about
        if variable.causality == "parameter":
            attributes["initial"] = "exact"
        if variable.causality == "output":
            attributes["initial"] = "calculated"
            outputs.append(number)
        if variable.start is not None:
            real["start"] = repr(float(variable.start))
        entry = ElementTree.SubElement(listed, "ScalarVariable", attributes)
        ElementTree.SubElement(entry, "Real", real)
    mode = ElementTree.SubElement(
        listed,
        "ScalarVariable",
        name="torque_mode",
        valueReference="0",
        causality="input",
        variability="discrete",
        description="whether torque_setpoint counts, not speed_setpoint",
    )
    ElementTree.SubElement(mode, "Boolean", start="false")
    slewed = ElementTree.SubElement(
        listed,
        "ScalarVariable",
        name="slewed",
        valueReference="1",
        causality="parameter",
        variability="fixed",
        initial="exact",
        description="whether the set-points come slewed, as from boards",
    )
    ElementTree.SubElement(slewed, "Boolean", start="false")
    structure = ElementTree.SubElement(root, "ModelStructure")
    for kind in ("Outputs", "InitialUnknowns"):
        part = ElementTree.SubElement(structure, kind)
        for number in outputs:
            ElementTree.SubElement(part, "Unknown", index=str(number))
    ElementTree.indent(root)
    text: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return text
