"""The mapping file: which variables of an FMU are which of our quantities."""

import dataclasses
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tricycle_core.documents import decode, parse_yaml, read_bounded
from tricycle_core.errors import PlantError, hint
from tricycle_core.timing import TICK

_LIMIT = 1_000_000  # bytes
QUANTITIES = {
    "steering": "rad",
    "speed": "m/s",
    "torque": "N m",
    "brake": "1",
    "torque_mode": "1",
    "x": "m",
    "y": "m",
    "heading": "rad",
    "vx": "m/s",
    "vy": "m/s",
    "yaw_rate": "rad/s",
    "ax": "m/s^2",
    "ay": "m/s^2",
    "steering_motor_angle": "rad",
    "steering_motor_rate": "rad/s",
    "drive_speed": "rad/s",
    "drive_angle": "rad",
    "motor_torque": "N m",
}
"""Our quantities by name, with their units."""
INPUTS = ("steering", "speed", "torque", "brake", "torque_mode")
"""Quantities that go into an FMU; all others come out."""
START = {"start_speed": "m/s", "start_speed_setpoint": "m/s"}
"""Parameters that are not the vehicle's: its speed at the start, and the set-point's."""
UNITS = {
    "rad": {"rad": 1.0, "deg": math.pi / 180.0},
    "m": {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "km": 1e3},
    "m/s": {"m/s": 1.0, "km/h": 1.0 / 3.6},
    "rad/s": {
        "rad/s": 1.0,
        "deg/s": math.pi / 180.0,
        "rev/min": math.pi / 30.0,
        "rpm": math.pi / 30.0,
    },
    "m/s^2": {"m/s^2": 1.0, "m/s2": 1.0, "g": 9.80665},
    "N m": {"N m": 1.0, "N.m": 1.0, "kN.m": 1e3},
    "1": {"1": 1.0, "%": 0.01},
}
"""Factor of each unit that an FMU may have, by our unit."""


@dataclass(frozen=True)
class Variable:
    """A variable of an FMU.

    Attributes
    ----------
    variable : str
        Name of the variable in the FMU.
    unit : str, optional
        Unit of the variable in the FMU; by default the one in its description, or ours.
    scale : float
        Factor: our value is the FMU's, converted to our unit, times this.
    """

    variable: str
    unit: str | None = None
    scale: float = 1.0


@dataclass(frozen=True, kw_only=True)
class FmuMapping:
    """A mapping file.

    Attributes
    ----------
    fmu : str
        Path of the FMU, from the mapping file's folder.
    inputs, outputs : mapping of str to Variable
        Variables by our quantity.
    parameters : mapping of str to Variable
        Variables by parameter of our vehicle file, or of the caller.
    start_values : mapping of str to float or bool
        Values of further variables of the FMU, in its units.
    step : float
        Communication step [s].
    folder : str
        Folder of the mapping file.
    """

    fmu: str
    inputs: dict[str, Variable]
    outputs: dict[str, Variable]
    parameters: dict[str, Variable] = field(default_factory=dict)
    start_values: dict[str, float | bool] = field(default_factory=dict)
    step: float = 0.01
    folder: str = "."

    @property
    def path(self) -> Path:
        """Path of the FMU."""
        return Path(self.folder) / self.fmu

    def steps_per_tick(self, file: Path, user: str, inputs: Collection[str]) -> int:
        """Return the communication steps of a tick, of a mapping that has what its user needs.

        Parameters
        ----------
        file : Path
            The mapping file, for the messages.
        user : str
            Who needs it, as "a plant".
        inputs : collection of str
            Inputs that the mapping must have; as outputs always x, y and heading.

        Raises
        ------
        PlantError
            If an input or output is missing, or the step does not divide a tick.
        """
        needed = (("inputs", inputs), ("outputs", ("x", "y", "heading")))
        for part, names in needed:
            for name in names:
                if name not in getattr(self, part):
                    raise PlantError(f"{file}: {part}: {user} needs {name}")
        steps = round(TICK / self.step)
        if steps < 1 or abs(steps * self.step - TICK) > 1e-9:
            raise PlantError(f"{file}: step: {self.step:g} s does not divide {TICK:g} s")
        return steps


def load_mapping(path: Path) -> FmuMapping:
    """Return the content of a mapping file.

    Parameters
    ----------
    path : Path
        YAML file.

    Raises
    ------
    PlantError
        If something does not fit; the message names file, entry, and what would be right.
    """
    content = read_bounded(path, _LIMIT, "mapping of an FMU", PlantError)
    values: Any = parse_yaml(content, str(path), PlantError)
    if not isinstance(values, Mapping):
        raise PlantError(f"{path}: must hold entries: fmu, inputs, outputs")
    known = ("fmu", "inputs", "outputs", "parameters", "start_values", "step")
    for name in values:
        if name not in known:
            raise PlantError(f"{path}: {name}: unknown; {hint(name, known)}")
    filled = dict(values)
    for part in ("inputs", "outputs", "parameters"):
        entries = filled.get(part) or {}
        if not isinstance(entries, Mapping):
            raise PlantError(f"{path}: {part}: must hold entries")
        filled[part] = {
            name: {"variable": entry} if isinstance(entry, str) else entry
            for name, entry in entries.items()
        }
        _check_names(path, part, entries)
    mapping = decode(FmuMapping, {**filled, "folder": str(path.parent)}, str(path), PlantError)
    if not (math.isfinite(mapping.step) and mapping.step > 0.0):
        raise PlantError(f"{path}: step: {mapping.step:g} must be positive (s)")
    for entries in (mapping.inputs, mapping.outputs, mapping.parameters):
        for name, variable in entries.items():
            if not math.isfinite(variable.scale) or variable.scale == 0.0:
                raise PlantError(f"{path}: {name}.scale: {variable.scale:g} must be finite, not 0")
    return mapping


def _check_names(path: Path, part: str, entries: Mapping[str, Any]) -> None:
    """Refuse an unknown quantity in a part of a mapping, and an unknown key of an entry."""
    keys = [entry.name for entry in dataclasses.fields(Variable)]
    for name, entry in entries.items():
        for key in entry if isinstance(entry, Mapping) else ():
            if key not in keys:
                raise PlantError(f"{path}: {part}.{name}.{key}: unknown; {hint(key, keys)}")
    for name in () if part == "parameters" else entries:
        right = [q for q in QUANTITIES if (q in INPUTS) == (part == "inputs")]
        if name not in right:
            raise PlantError(f"{path}: {part}.{name}: unknown; {hint(name, right)}")
