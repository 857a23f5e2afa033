"""Vehicle files with the estimates of an identification."""

from pathlib import Path

import yaml

from parameter_identification.estimation.results import Estimate, Identification
from parameter_identification.many_drives import ManyDrives
from tricycle_core import __version__
from tricycle_sim.vehicle import vehicle_document

NAMED = 6  # drives that a line has room for
RANGE = 3.0  # standard deviations either side that the file leaves possible


def kind_of_drives(found: Identification | ManyDrives) -> str:
    """Return what the drives are: windows where all are of a recording.

    Parameters
    ----------
    found : Identification or ManyDrives
        What was identified.
    """
    return "windows" if all(_recordings(found)) else "drives"


def named_drives(found: Identification | ManyDrives) -> str:
    """Return the names of the drives in a row; where there are many, their number.

    Parameters
    ----------
    found : Identification or ManyDrives
        What was identified.
    """
    names, recordings = [drive.name for drive in found.drives], _recordings(found)
    if len(names) <= NAMED:
        return ", ".join(names)
    of = f" of {', '.join(recordings)}" if all(recordings) and len(recordings) <= NAMED else ""
    return f"{len(names)} {kind_of_drives(found)}{of}"


def _recordings(found: Identification | ManyDrives) -> list[str]:
    """Names of the recordings that the drives are windows of; one is empty if one is none."""
    of_drives = found.drives if isinstance(found, Identification) else ()
    return list(dict.fromkeys(drive.recording for drive in of_drives)) or [""]


def identified_vehicle(found: Identification | ManyDrives, source: Path | None) -> str:
    """Return the text of a vehicle file with the estimates.

    Parameters that the drives show get their estimate as nominal value and as range three standard
    deviations either side, so that the next plan looks for what is still unknown; the others stay
    as they were. Each entry names its source.

    Parameters
    ----------
    found : Identification or ManyDrives
        Result for that vehicle.
    source : Path or None
        Its file; None: the packaged tricycle.
    """
    document = vehicle_document(source)
    where = named_drives(found)
    doubt = ""
    if not found.white:
        doubt = ", but the residuals are not white: the model lacks something or a sensor drifts"
    elif isinstance(found, Identification) and found.deviations:
        names = ", ".join(effect.name for effect in found.deviations)
        doubt = f", but the vehicle moves as the model cannot ({names})"
    for name, estimate in found.parameters.items():
        entry = document["constants"][name]
        about = entry["about"]
        if estimate.identifiable:
            low, high = _range(estimate)
            entry.update(nominal=estimate.estimate, range=[low, high], basis="data")
            about = (
                f"identified from {where}: {100 * found.level:g} % interval "
                f"{estimate.low:.5g} to {estimate.high:.5g}"
                f"{doubt}; range: {RANGE:g} "
                f"standard deviations; before: {about}"
            )
        else:
            about = f"not shown by {where}; {about}"
        entry["about"] = about
    header = (
        f"# {document['name']} with parameters identified from {where}\n"
        f"# by tricycle identify {__version__}, vehicle file before: "
        f"{source or 'tricycle.yaml'} ({found.vehicle_hash})\n"
    )
    if isinstance(found, Identification) and found.effects:
        header += "# effects, estimated too:\n" + "".join(f"#   {e}\n" for e in found.effects)
    body: str = yaml.safe_dump(document, sort_keys=False, allow_unicode=True, width=120)
    return header + body


def _range(estimate: Estimate) -> tuple[float, float]:
    reach = RANGE * estimate.standard_deviation
    return (
        max(estimate.range[0], estimate.estimate - reach),
        min(estimate.range[1], estimate.estimate + reach),
    )
