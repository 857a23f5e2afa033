"""When a drive may end before its plan."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Enough:
    """What a drive is to teach: it is ended when `identification_monitor` says that it has.

    Attributes
    ----------
    plan_file : Path
        Of the drive.
    known_file : Path, optional
        Identification of earlier drives.
    targets : tuple of str
        Parameters that are to be known.
    tolerance : float
        Half width of their 95 % intervals, as a share of the estimates.
    """

    plan_file: Path
    known_file: Path | None
    targets: tuple[str, ...]
    tolerance: float
