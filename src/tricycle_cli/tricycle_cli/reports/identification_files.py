"""Names of the files of an identification, known before what draws some of them is imported."""

from collections.abc import Collection
from pathlib import Path

IDENTIFICATION, VEHICLE, REPORT = "identification.json", "vehicle.yaml", "report.html"
FIGURES = "trajectories", "residuals", "lack", "profiles"
FILES = (IDENTIFICATION, VEHICLE, REPORT, *(f"{name}.png" for name in FIGURES))
"""Names of the files that an identification may write."""


def remove_older(folder: Path, written: Collection[str]) -> None:
    """Remove the files of an earlier identification that this one has not replaced.

    Parameters
    ----------
    folder : Path
        Folder of the identification.
    written : collection of str
        Names of the files that this one has written.
    """
    for name in set(FILES) - set(written):
        (folder / name).unlink(missing_ok=True)
