"""Vehicle files with the estimates of an identification."""

import dataclasses
from pathlib import Path
from typing import Any

import yaml

from parameter_identification.estimation.results import DriveFit, Estimate, Identification
from parameter_identification.many_drives import ManyDrives
from tricycle_core import __version__
from tricycle_sim.effects import (
    SERVO_DEAD_TIME,
    SPEED_LOOP,
    STEERING_GAIN,
    STEERING_ZERO,
    corrected,
    extend,
)
from tricycle_sim.vehicle import Vehicle, load_vehicle, vehicle_document

NAMED = 6  # drives that a line has room for
RANGE = 3.0  # standard deviations either side that the file leaves possible
OF_BOARDS = (SPEED_LOOP,)
"""Effects on constants that the boards are set up with: they would be changed once more.

Neither is `speed_scale` written where the radius of the tyres is: the boards then know it.
"""
OF_TABLES = (SERVO_DEAD_TIME,)
"""Effects that in other systems' tables, or bags of these, also stand for late logged steering."""
OF_ESTIMATED_MAPS = STEERING_ZERO, STEERING_GAIN
"""Effects that stand for the error of a map from the steering of a table, where it was estimated.
"""


def kind_of_drives(found: Identification | ManyDrives) -> str:
    """Return "windows" where all drives are of a recording, else "drives".

    Parameters
    ----------
    found : Identification or ManyDrives
        Result of the identification.
    """
    return "windows" if all(_recordings(found)) else "drives"


def named_drives(found: Identification | ManyDrives) -> str:
    """Return the names of the drives in a row; where there are many, their number.

    Parameters
    ----------
    found : Identification or ManyDrives
        Result of the identification.
    """
    names, recordings = [drive.name for drive in found.drives], _recordings(found)
    if len(names) <= NAMED:
        return ", ".join(names)
    of = f" of {', '.join(recordings)}" if all(recordings) and len(recordings) <= NAMED else ""
    return f"{len(names)} {kind_of_drives(found)}{of}"


def _recordings(found: Identification | ManyDrives) -> list[str]:
    """Names of the recordings that the drives are windows of; one is empty if one is none."""
    return list(dict.fromkeys(drive.recording for drive in _fits(found))) or [""]


def _fits(found: Identification | ManyDrives) -> tuple[DriveFit, ...]:
    return found.drives if isinstance(found, Identification) else ()


def identified_vehicle(found: Identification | ManyDrives, source: Path | None) -> str:
    """Return the text of a vehicle file that moves as the best fit does.

    All that was estimated together is its nominal value: parameters, and effects that are constants
    of the vehicle. Parameters that the drives show get as range three standard deviations either
    side, so that the next plan looks for what is still unknown; the others keep theirs. That of a
    constant that was held is widened where an effect takes it further. Each entry names its source.

    The boards are set up with the file. What an effect says about them (`OF_BOARDS`) is not written
    into it, nor is what would make it too stiff for the simulation.

    Parameters
    ----------
    found : Identification or ManyDrives
        Result for that vehicle.
    source : Path or None
        Vehicle file of that vehicle; None: the packaged tricycle.
    """
    document, vehicle = vehicle_document(source), load_vehicle(source)
    where = named_drives(found)
    doubt = ""
    if not found.white:
        doubt = ", but the residuals are not white: the model lacks something or a sensor drifts"
    elif found.deviations:
        names = ", ".join(effect.name for effect in found.deviations)
        doubt = f", but the vehicle moves as the model cannot ({names})"
    for name, estimate in {**found.parameters, **found.others}.items():
        entry = document["constants"][name]
        about = entry["about"]
        entry.update(nominal=estimate.estimate, range=list(estimate.range), unit=vehicle.unit(name))
        if name in found.parameters and estimate.identifiable:
            entry.update(range=list(_range(estimate)), basis="data")
            about = (
                f"identified from {where}: {100 * found.level:g} % interval "
                f"{estimate.low:.5g} to {estimate.high:.5g}"
                f"{doubt}; range: {RANGE:g} "
                f"standard deviations; before: {about}"
            )
        else:
            why = "not shown by" if name in found.parameters else "not asked of"
            how = "fits best beside the others"
            if not found.converged:
                how = "where the search was given up: NO minimum was found"
            about = f"{why} {where}, {how}; before: {about}"
        entry["about"] = about
        vehicle = vehicle.replace(**{name: estimate.estimate})
    header = (
        f"# {document['name']} with parameters identified from {where}\n"
        f"# by tricycle identify {__version__}, vehicle file before: "
        f"{source or 'tricycle.yaml'} ({found.vehicle_hash})\n"
    )
    if found.effects:
        header += "# effects, estimated too; * also as constants below:\n"
        held = _write_effects(document, vehicle, found)
        for e in found.effects:
            header += f"# {'*' if e.name in held else ' '} {e}\n"
    body: str = yaml.safe_dump(document, sort_keys=False, allow_unicode=True, width=120)
    return header + body


def _write_effects(
    document: Any, vehicle: Vehicle, found: Identification | ManyDrives
) -> frozenset[str]:
    """Write effects that are constants into a vehicle's document; return those wholly in it."""
    ranges, estimated = vehicle.unknown, {*found.parameters, *found.others}
    unknown = {name: ends for name, ends in ranges.items() if name in estimated}
    before = dataclasses.replace(vehicle, unknown=unknown)  # those that were held may have effects
    logged = [drive.steering_late > 0.0 for drive in found.drives]
    tables = all(_recordings(found)) or (bool(logged) and all(logged))
    left_out: tuple[str, ...] = () if tables else OF_BOARDS
    if tables or any(logged):
        left_out += OF_TABLES
    if any(drive.map_estimated for drive in _fits(found)):
        left_out += OF_ESTIMATED_MAPS
    after, held = corrected(
        before,
        {e.name: e.estimate for e in found.effects if not e.drive and e.name not in left_out},
    )
    if "speed_scale" in before.values and not tables:
        after = after.replace(speed_scale=before.speed_scale)
    laws = {part: law for part, law in after.parts.items() if before.parts.get(part) != law}
    if laws:
        document.setdefault("parts", {}).update(laws)
    plain = extend(before, laws).values
    for name, value in after.values.items():
        if value == plain[name]:
            continue
        entry = document["constants"].setdefault(name, {})
        about = f"with the effects found in {named_drives(found)}; before: {plain[name]:.5g}, "
        about += entry.get("about", "the default")
        if value in after.bounds(name):
            about = f"at the end of what any vehicle has, {about}"
        entry.update(unit=after.unit(name), basis="data", about=about)
        if name in ranges:
            low, high = ranges[name]
            entry.update(nominal=value, range=[min(value, low), max(value, high)])
        else:
            entry["value"] = value
    return held


def _range(estimate: Estimate) -> tuple[float, float]:
    reach = RANGE * estimate.standard_deviation
    return (
        max(estimate.range[0], estimate.estimate - reach),
        min(estimate.range[1], estimate.estimate + reach),
    )
