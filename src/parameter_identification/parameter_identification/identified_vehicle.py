"""Vehicle files with the estimates of an identification."""

from collections.abc import Sequence
from pathlib import Path

import yaml

from parameter_identification.estimation.results import Estimate, Identification
from parameter_identification.many_drives import ManyDrives
from tricycle_core import __version__
from tricycle_sim.vehicle import vehicle_document

NAMED = 6  # drives that a line has room for
RANGE = 3.0  # standard deviations either side that the file leaves possible


def named(drives: Sequence[str]) -> str:
    """Return the names of drives in a row, or their number where there are many.

    Parameters
    ----------
    drives : sequence of str
        Their names.
    """
    return ", ".join(drives) if len(drives) <= NAMED else f"{len(drives)} drives"


def identified_vehicle(
    found: Identification | ManyDrives, source: Path | None, *, bags: Sequence[str] = ()
) -> str:
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
    bags : sequence of str, optional
        That the estimates come from. Default: the names of the drives, or their number.
    """
    document = vehicle_document(source)
    where = named(bags or [drive.name for drive in found.drives])
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
        header += "# estimated beside them:\n" + "".join(f"#   {e}\n" for e in found.effects)
    body: str = yaml.safe_dump(document, sort_keys=False, allow_unicode=True, width=120)
    return header + body


def _range(estimate: Estimate) -> tuple[float, float]:
    reach = RANGE * estimate.standard_deviation
    return (
        max(estimate.range[0], estimate.estimate - reach),
        min(estimate.range[1], estimate.estimate + reach),
    )
