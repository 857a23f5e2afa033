"""Names of drives, by which results tell them apart."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain, count
from pathlib import Path

from parameter_identification.drives.measured import MeasuredDrive

SUFFIXES = (".mcap", ".db3", ".zstd")  # of files; what follows a point in another name counts


def name_of(bag: Path) -> str:
    """Return the name of a bag.

    Parameters
    ----------
    bag : Path
        rosbag2 directory, or file, of which the suffix is left out.
    """
    return bag.stem if bag.suffix in SUFFIXES else bag.name


def names_of(bags: Sequence[Path]) -> list[str]:
    """Return different names of bags, with as many of their folders as tell them apart.

    Parameters
    ----------
    bags : sequence of Path
        One or more.
    """
    names: list[str] = []
    for folders in range(1 + max(len(bag.parts) for bag in bags)):
        first = [max(len(bag.parts) - 1 - folders, 0) for bag in bags]
        names = ["/".join((*b.parts[i:-1], name_of(b))) for b, i in zip(bags, first, strict=True)]
        if len(set(names)) == len(names):
            break
    return _numbered(names)


def told_apart(drives: Sequence[MeasuredDrive]) -> list[MeasuredDrive]:
    """Return drives of which each has another name: one that is taken gets a number.

    Parameters
    ----------
    drives : sequence of MeasuredDrive
        Drives that are fitted or predicted together.
    """
    names = _numbered([drive.name for drive in drives])
    return [replace(drive, name=name) for drive, name in zip(drives, names, strict=True)]


def _numbered(names: Sequence[str]) -> list[str]:
    found: dict[str, None] = {}
    for name in names:
        tries = chain([name], (f"{name} ({number})" for number in count(2)))
        found[next(one for one in tries if one not in found)] = None
    return [*found]
