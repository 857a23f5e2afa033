"""Checks before a drive: what a start needs, each with how it stands."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from tricycle_core.diagnostics import Level
from tricycle_core.namesakes import LEFT_BEHIND, namesakes

SILENCE = 3.0
"""Age beyond which what another node said of itself does not count [s]."""


@dataclass(frozen=True)
class Check:
    """One item of the pre-flight.

    Attributes
    ----------
    name : str
        What is checked.
    message : str
        Result in one line.
    level : Level
        Severity; ERROR refuses the start.
    """

    name: str
    message: str
    level: Level = Level.OK

    @classmethod
    def of(cls, name: str, problem: str, well: str) -> Check:
        """Return a check that fails if there is a problem.

        Parameters
        ----------
        name : str
            What is checked.
        problem : str
            What is wrong; empty if nothing is.
        well : str
            Message if nothing is wrong.
        """
        return cls(name, problem or well, Level.ERROR if problem else Level.OK)


def commanders(own: str, publishers: Iterable[str]) -> Check:
    """Return whether somebody else could command the vehicle, a namesake of the driver too.

    Parameters
    ----------
    own : str
        Name of the driver.
    publishers : iterable of str
        Names of all publishers of commands, one for each.
    """
    every = list(publishers)
    others = sorted(set(every) - {own})
    more = f"{', '.join(others)} could command too: end it; {LEFT_BEHIND}" if others else ""
    return Check.of("commanders", namesakes(every) or more, "nobody else")


def clock(stood: float, *, simulated: bool) -> Check:
    """Return whether the clock runs: that of a simulation that has ended stands still.

    Parameters
    ----------
    stood : float
        Time since the driver's last tick, by the computer's steady clock [s].
    simulated : bool
        Whether the ticks are those of a simulation's clock.
    """
    still = (
        f"/clock has stood still for {stood:.0f} s, and with it pose and state of the vehicle: "
        "is the simulation running?"
        if simulated
        else f"the driver has been held up for {stood:.0f} s: a busy computer?"
    )
    return Check.of("clock", still if stood > SILENCE else "", "runs")


@dataclass(frozen=True)
class Report:
    """Diagnostic status that another node published.

    Attributes
    ----------
    level : Level
        Severity.
    message : str
        The same in words.
    heard : tuple of float
        Time of receipt on each of some clocks [s].
    values : mapping of str to str
        Details.
    """

    level: Level
    message: str
    heard: tuple[float, ...]
    values: Mapping[str, str] = field(default_factory=dict)

    def check(self, name: str, now: tuple[float, ...]) -> Check:
        """Return the item of the pre-flight; it fails if the node is silent by every clock.

        Parameters
        ----------
        name : str
            Name of the part that is checked.
        now : tuple of float
            Present time on the clocks of `heard` [s].
        """
        # nodes report by a simulation's clock or by the computer's: either may be the faster one
        age = min(time - heard for time, heard in zip(now, self.heard, strict=True))
        if age > SILENCE:
            return Check(name, f"silent for {age:.0f} s: {self.message}", Level.ERROR)
        return Check(name, self.message, min(self.level, Level.ERROR))


RECORDER = "trajectory_recorder: bag"
"""Name under which the recorder says how it is."""


def recording(
    report: Report | None, duration: float, now: tuple[float, ...], *, needed: bool
) -> Check:
    """Return whether a bag is recorded, and whether the disk has room for the drive.

    Parameters
    ----------
    report : Report, optional
        Newest report of the recorder.
    duration : float
        Duration of the drive [s].
    now : tuple of float
        Present time on the clocks of the report [s].
    needed : bool
        Whether a drive is refused if it is not recorded.
    """
    missing = Level.ERROR if needed else Level.WARN
    if report is None:
        return Check(RECORDER, "no recorder heard", missing)
    check = report.check(RECORDER, now)
    if check.level is Level.ERROR:
        return Check(RECORDER, check.message, missing)
    if "bag" not in report.values or "paused" in report.values:
        return Check(RECORDER, check.message, missing)
    try:
        free, rate = (float(report.values[key]) for key in ("disk_free", "bytes_per_second"))
    except (KeyError, ValueError):
        return check
    room = f"{free / 1e9:.1f} GB free"
    if rate * duration > free:
        wanted = f"{room}, but the drive may take {rate * duration / 1e9:.1f} GB: make room"
        return Check(RECORDER, wanted, missing)
    return Check(RECORDER, f"{check.message}, {room}", check.level)
