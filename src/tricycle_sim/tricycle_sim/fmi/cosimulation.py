"""An FMU 2.0 or 3.0 for co-simulation, through FMPy, in our quantities and units."""

import contextlib
import math
import shutil
import tempfile
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from tricycle_core.errors import PlantError, hint
from tricycle_core.optional import missing
from tricycle_sim.fmi.mapping import QUANTITIES, UNITS, FmuMapping, Variable

try:
    import fmpy
    from fmpy.simulation import instantiate_fmu
except ModuleNotFoundError as error:
    raise PlantError(missing("fmpy", "an FMU")) from error

_FLOATS = ("Real", "Float64", "Float32")
_INTEGERS = ("Integer", *(f"{sign}Int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64)))
_TYPES = (*_FLOATS, *_INTEGERS, "Boolean", "Enumeration")
_DESCRIPTION = "modelDescription.xml"
_TOLD = 4  # binaries that are named


class Fmu:
    """An FMU with a mapping: its description checked, its binary unpacked.

    Parameters
    ----------
    mapping : FmuMapping
        Mapping, from `load_mapping`.
    units : mapping of str to str, optional
        Unit of each parameter of the caller; those that the mapping lacks are left out.

    Attributes
    ----------
    mapping : FmuMapping
        Mapping of our quantities to the FMU's variables.
    places : dict
        Type, value reference, and factor from the FMU's unit to ours, by part of the mapping and
        name.
    readings : dict
        Names of outputs, their value references, and factors from the FMU's units to ours, by type.
    only_once : bool
        Whether a process can have one instance of it at a time.

    Raises
    ------
    PlantError
        If it is not an FMU, not for co-simulation, has no binary for this platform, lacks a
        variable, or one has a wrong unit or causality.
    """

    def __init__(self, mapping: FmuMapping, units: Mapping[str, str] | None = None) -> None:
        self.mapping = mapping
        path = mapping.path
        if not path.is_file():
            raise PlantError(f"{path}: there is no such FMU")
        version = _version_of(path)
        if not version.startswith(("2", "3")):
            raise PlantError(f"{path}: needs an FMU 2.0 or 3.0; this one is of FMI {version}")
        try:
            self._description = fmpy.read_model_description(str(path), validate=False)
        except Exception as error:
            raise PlantError(
                f"{path}: is not an FMU: {_DESCRIPTION} is none of FMI {version} ({_line(error)})"
            ) from error
        if self._description.coSimulation is None:
            raise PlantError(f"{path}: needs an FMU for co-simulation; this one is not")
        self.only_once = bool(self._description.coSimulation.canBeInstantiatedOnlyOncePerProcess)
        self._variables = {v.name: v for v in self._description.modelVariables}
        self.places: dict[tuple[str, str], tuple[str, int, float]] = {}
        self.readings: dict[str, tuple[list[Any], ...]] = {}
        for name, variable in mapping.inputs.items():
            self._check("inputs", name, variable, ("input",), QUANTITIES[name])
        for name, variable in mapping.outputs.items():
            self._check("outputs", name, variable, ("output", "local"), QUANTITIES[name])
        for name, variable in mapping.parameters.items():
            unit = (units or {}).get(name)
            self._check("parameters", name, variable, ("parameter", "input"), unit)
        for name in mapping.start_values:
            start_value = self._find("start_values", name)
            self.places["start_values", name] = (
                self._kind(start_value),
                start_value.valueReference,
                1.0,
            )
        self._folder = tempfile.mkdtemp(prefix="fmu-")
        try:
            fmpy.extract(str(path), unzipdir=self._folder)
        except Exception as error:
            self.close()
            raise PlantError(f"{path}: cannot be unpacked: {_line(error)}") from error
        try:
            self._check_binary(version)
        except PlantError:
            self.close()
            raise

    def _check_binary(self, version: str) -> None:
        """Raise a `PlantError` unless there is a binary for this platform."""
        needed = fmpy.platform if version.startswith("2") else fmpy.platform_tuple
        binaries = Path(self._folder) / "binaries"
        name = self._description.coSimulation.modelIdentifier + fmpy.sharedLibraryExtension
        if not (binaries / needed / name).is_file():
            files = (file for file in binaries.glob("*/*") if file.is_file())
            there = sorted(f"{file.parent.name}/{file.name}" for file in files)
            raise PlantError(
                f"{self.mapping.path}: has no binary for this platform, {needed}/{name}; it has: "
                f"{', '.join(there[:_TOLD]) or 'none'}{', …' if len(there) > _TOLD else ''}"
            )

    def _find(self, part: str, name: str) -> Any:
        if name not in self._variables:
            raise PlantError(
                f"{self.mapping.path}: {part}: no variable {name!r}; {hint(name, self._variables)}"
            )
        return self._variables[name]

    def _kind(self, found: Any) -> str:
        """Return the type with which a variable is read and written."""
        if found.type == "Enumeration":
            return "Integer" if self._description.fmiVersion.startswith("2") else "Int64"
        return str(found.type)

    def _check(
        self, part: str, name: str, wanted: Variable, causalities: tuple[str, ...], unit: str | None
    ) -> None:
        """Raise a `PlantError` unless a variable fits; keep the factor of its unit."""
        where = f"{self.mapping.path}: {part}.{name}"
        variable = self._find(part, wanted.variable)
        if variable.causality not in causalities:
            raise PlantError(
                f"{where}: {wanted.variable} is {variable.causality or 'local'}, needs "
                f"{' or '.join(causalities)}"
            )
        if variable.type not in _TYPES:
            raise PlantError(f"{where}: {wanted.variable} is {variable.type}, needs a number")
        own = variable.unit or (variable.declaredType.unit if variable.declaredType else None)
        if own and wanted.unit and _plain(own) != _plain(wanted.unit):
            raise PlantError(
                f"{where}: unit: the FMU has {wanted.variable} in {own}, not {wanted.unit}"
            )
        told = wanted.unit or own
        factor = 1.0
        if told and unit and _plain(told) != _plain(unit):
            factors = {_plain(name): value for name, value in UNITS.get(unit, {}).items()}
            if _plain(told) not in factors:
                raise PlantError(
                    f"{where}: unit: {wanted.variable} is in {told}, needs "
                    f"{' or '.join(UNITS.get(unit, {unit: 1.0}))}"
                )
            factor = factors[_plain(told)]
        kind = self._kind(variable)
        self.places[part, name] = kind, variable.valueReference, factor * wanted.scale
        if part == "outputs":
            reading = self.readings.setdefault(kind, ([], [], []))
            for column, entry in zip(reading, (name, *self.places[part, name][1:]), strict=True):
                column.append(entry)

    def start(self, parameters: Mapping[str, float] | None = None) -> "Instance":
        """Return an instance that is initialised.

        Parameters
        ----------
        parameters : mapping of str to float, optional
            Values of parameters of the mapping, in our units.

        Raises
        ------
        PlantError
            If the FMU refuses.
        """
        return Instance(self, parameters or {})

    def close(self) -> None:
        """Remove what was unpacked."""
        shutil.rmtree(self._folder, ignore_errors=True)


class Instance:
    """A running FMU.

    Parameters
    ----------
    fmu : Fmu
        FMU that runs.
    parameters : mapping of str to float
        Values of the parameters, as in `Fmu.start`.
    """

    def __init__(self, fmu: Fmu, parameters: Mapping[str, float]) -> None:
        self._fmu, self._steps = fmu, 0
        self._where = fmu.mapping.path
        description = fmu._description  # noqa: SLF001 (of the same module)
        self._slave: Any = None
        self._complaint = ""  # of the FMU, since its last call
        # FMPy goes into the FMU's folder, and stays there if its library does not load
        with self._telling("does not start"), contextlib.chdir(Path.cwd()):
            self._slave = instantiate_fmu(
                fmu._folder,  # noqa: SLF001
                description,
                fmi_type="CoSimulation",
                logger=self._log,
            )
        try:
            self._write("start_values", fmu.mapping.start_values)
            self._write("parameters", parameters)
            with self._telling("does not initialise"):
                if description.fmiVersion.startswith("3"):
                    self._slave.enterInitializationMode(startTime=0.0)
                else:
                    self._slave.setupExperiment(startTime=0.0)
                    self._slave.enterInitializationMode()
                self._slave.exitInitializationMode()
        except PlantError:
            self.close()
            raise

    @property
    def _running(self) -> Any:
        """FMPy's instance; raises once it has ended, as calling it would crash the process."""
        if self._slave is None:
            raise PlantError(f"{self._where}: has ended")
        return self._slave

    @contextlib.contextmanager
    def _telling(self, what: str) -> Any:
        self._complaint = ""
        try:
            yield
        except PlantError:
            raise
        except Exception as error:  # whatever FMPy makes of the FMU's answer
            why = f" ({self._complaint})" if self._complaint else ""
            line = _line(error).replace(f"{self._fmu._folder}/", "")  # noqa: SLF001 (of the same module)
            raise PlantError(f"{self._where}: {what}: {line}{why}") from error

    def _log(self, *entry: Any) -> None:
        """Keep what the FMU says: it explains the call that fails, if one does."""
        message = entry[-1]  # after the instance, its name in FMI 2.0, status, and category
        self._complaint = _first_line(message.decode(errors="replace")) if message else ""

    def _write(self, part: str, values: Mapping[str, float]) -> None:
        by_kind: dict[str, tuple[list[int], list[Any]]] = {}
        for name, value in values.items():
            place = self._fmu.places.get((part, name))
            if place is None:
                continue
            kind, reference, factor = place
            references, numbers = by_kind.setdefault(kind, ([], []))
            references.append(reference)
            number = value / factor
            with self._telling(f"refuses {name} = {number:g}"):
                numbers.append(number if kind in _FLOATS else round(number))
        for kind, (references, numbers) in by_kind.items():
            with self._telling(
                f"refuses {', '.join(f'{name} = {v:g}' for name, v in values.items())}"
            ):
                getattr(self._running, f"set{kind}")(references, numbers)

    def set(self, **inputs: float) -> None:
        """Set inputs; those that the mapping lacks are left out.

        Parameters
        ----------
        **inputs : float
            Value of each of our quantities, in our units.

        Raises
        ------
        PlantError
            If the FMU refuses a value, or has ended.
        """
        self._write("inputs", inputs)

    def advance(self) -> None:
        """Move on by a communication step.

        Raises
        ------
        PlantError
            If the FMU fails, or has ended.
        """
        step = self._fmu.mapping.step
        with self._telling(f"fails at {self._steps * step:.2f} s"):
            told = self._running.doStep(
                currentCommunicationPoint=self._steps * step, communicationStepSize=step
            )
        if isinstance(told, tuple):  # FMI 3.0: event, terminate, early return, time
            _, ends, early, _ = told
            if ends or early:
                raise PlantError(f"{self._where}: ends at {self._steps * step:.2f} s")
        self._steps += 1

    def read(self) -> dict[str, float]:
        """Return all outputs of the mapping by our quantity, in our units.

        Raises
        ------
        PlantError
            If one is not finite, or the FMU has ended.
        """
        found = {}
        for kind, (names, references, factors) in self._fmu.readings.items():
            with self._telling("does not tell its outputs"):
                values = getattr(self._running, f"get{kind}")(references)
            for name, value, factor in zip(names, values, factors, strict=True):
                found[name] = float(value) * factor
                if not math.isfinite(found[name]):
                    variable = self._fmu.mapping.outputs[name].variable
                    time = self._steps * self._fmu.mapping.step
                    raise PlantError(f"{self._where}: {variable} is {value} at {time:.2f} s")
        return found

    def close(self) -> None:
        """End the instance; a second call does nothing."""
        slave, self._slave = self._slave, None
        if slave is None:
            return
        with contextlib.suppress(Exception):  # it may be beyond that already
            slave.terminate()
        with contextlib.suppress(Exception):
            slave.freeInstance()


def _version_of(path: Path) -> str:
    """Return the version of FMI that an FMU names; of another one FMPy makes no sense."""
    try:
        with zipfile.ZipFile(path) as archive, archive.open(_DESCRIPTION) as file:
            _, root = next(ElementTree.iterparse(file, events=("start",)))  # noqa: S314 (as FMPy)
    except KeyError as error:
        raise PlantError(f"{path}: is not an FMU: it has no {_DESCRIPTION}") from error
    except Exception as error:  # of the archive, its compression, or XML
        raise PlantError(f"{path}: is not an FMU: {_line(error)}") from error
    version: str | None = root.get("fmiVersion")
    if version is None:
        raise PlantError(f"{path}: is not an FMU: {_DESCRIPTION} names no fmiVersion")
    return version


def _plain(unit: str) -> str:
    """Return a unit without what is written one way or another."""
    return unit.replace(" ", "").replace(".", "").replace("*", "").replace("^", "")


def _line(error: Exception) -> str:
    """Return the first line of what an exception says."""
    return _first_line(str(error)) or type(error).__name__


def _first_line(text: str) -> str:
    return next(iter(text.strip().splitlines()), "")
