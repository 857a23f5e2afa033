"""Conditions under which a drive may end before its plan."""

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Enough:
    """Aim of a drive: `identification_monitor` says when it is reached, which ends the drive.

    Attributes
    ----------
    plan_file : Path
        Plan of the drive.
    known_file : Path, optional
        Identification from earlier drives.
    targets : tuple of str
        Parameters to be known within `tolerance`.
    tolerance : float
        Half width of their 95 % intervals, as a share of the estimates.
    """

    plan_file: Path
    known_file: Path | None
    targets: tuple[str, ...]
    tolerance: float
