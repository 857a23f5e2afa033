"""Display of a live run in a terminal: links, maneuver, speeds, progress."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeVar

from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.measure import Measurement
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from tricycle_core.diagnostics import Level
from tricycle_core.documents import finite_or_none
from tricycle_core.maneuver_state import PlaybackState

SILENCE = 3.0  # s after which a source counts as silent; diagnostics come once a second


_STATE_STYLES = {
    PlaybackState.RUNNING.value: "bold cyan",
    PlaybackState.DONE.value: "green",
    PlaybackState.ABORTED.value: "bold red",
}
_DRIVING = {state.value for state in PlaybackState if state.driving}
_STYLES = {Level.OK: "green", Level.WARN: "yellow", Level.ERROR: "bold red", Level.STALE: "dim"}


@dataclass(frozen=True)
class DiagnosticEntry:
    """One entry of the diagnostics.

    Attributes
    ----------
    level : Level
        Level of that part of the system.
    message : str
        The state in words.
    heard : float
        Time of receipt [s], on the clock of the dashboard.
    """

    level: Level
    message: str
    heard: float


def diagnostic_entries(statuses: Iterable[Any], heard: float) -> dict[str, DiagnosticEntry]:
    """Return the entries of a DiagnosticArray by name.

    Parameters
    ----------
    statuses : iterable of DiagnosticStatus
        Statuses of a DiagnosticArray.
    heard : float
        Time of receipt [s], on the clock of the dashboard.
    """
    return {s.name: DiagnosticEntry(Level.of(s.level), s.message, heard) for s in statuses}


@dataclass(frozen=True)
class JointReading:
    """Commanded or measured values of the two joints.

    Attributes
    ----------
    steering_motor_angle : float
        Position of the steering motor [rad].
    wheel_rate : float
        Rate of the rear wheel [rad/s].
    heard : float
        Time of receipt [s], on the clock of the dashboard.
    """

    steering_motor_angle: float
    wheel_rate: float
    heard: float = math.inf


@dataclass(frozen=True)
class OdometryReading:
    """Position and speed in `odom`.

    Attributes
    ----------
    x, y : float
        Position [m].
    speed : float
        Speed, forward positive [m/s].
    yaw_rate : float
        Yaw rate, left positive [rad/s].
    heard : float
        Time of receipt [s], on the clock of the dashboard.
    """

    x: float
    y: float
    speed: float
    yaw_rate: float
    heard: float = math.inf


Reading = TypeVar("Reading", JointReading, OdometryReading)


@dataclass
class Dashboard:
    """The newest message of each source; None or empty where there was none.

    Attributes
    ----------
    diagnostics : dict of str to DiagnosticEntry
        Newest diagnostics by name, `node: part`.
    maneuver : mapping of str to str
        Values of `maneuver/state`.
    commanded, measured : JointReading, optional
        Newest commands and states of the joints.
    odometry : OdometryReading, optional
        Newest pose and speed.
    heard : float, optional
        Time of receipt of the newest message of any kind [s].
    learnt : str
        Content of `identification/estimates`, in words.
    preflight : mapping of str to DiagnosticEntry
        Content of `maneuver/preflight`, by name of the check.
    """

    diagnostics: dict[str, DiagnosticEntry] = field(default_factory=dict)
    maneuver: Mapping[str, str] = field(default_factory=dict)
    commanded: JointReading | None = None
    measured: JointReading | None = None
    odometry: OdometryReading | None = None
    heard: float | None = None
    learnt: str = ""
    preflight: Mapping[str, DiagnosticEntry] = field(default_factory=dict)

    @property
    def complete(self) -> bool:
        """Whether everything was heard that bridge, driver and localisation always publish."""
        return bool(self.diagnostics and self.maneuver and self.measured and self.odometry)

    def snapshot(self) -> dict[str, object]:
        """Return the same as JSON values; a number that is not finite is None."""
        return {
            "maneuver": dict(self.maneuver),
            "learnt": self.learnt,
            "preflight": _levels_and_messages(self.preflight),
            "diagnostics": _levels_and_messages(self.diagnostics),
            "commanded": _numbers(self.commanded),
            "measured": _numbers(self.measured),
            "odom": _numbers(self.odometry),
        }


def _numbers(reading: JointReading | OdometryReading | None) -> dict[str, float | None] | None:
    if reading is None:
        return None
    return {n: finite_or_none(value) for n, value in vars(reading).items() if n != "heard"}


def _levels_and_messages(entries: Mapping[str, DiagnosticEntry]) -> dict[str, dict[str, str]]:
    return {
        name: {"level": entry.level.name.lower(), "message": entry.message}
        for name, entry in entries.items()
    }


def screen(dashboard: Dashboard, *, now: float, where: str) -> RenderableType:
    """Return the dashboard, drawn for the terminal.

    Parameters
    ----------
    dashboard : Dashboard
        Dashboard to draw.
    now : float
        Present time [s], on the clock of the dashboard.
    where : str
        Domain and namespace of the nodes.
    """
    if dashboard.heard is None:
        news = Text(f"{where}: nothing heard yet", style="yellow")
    elif now - dashboard.heard > SILENCE:
        news = Text(f"{where}: silent for {now - dashboard.heard:.0f} s", style="bold red")
    else:
        news = Text(where)
    parts = {"maneuver": _maneuver(dashboard), "motion": _speeds(dashboard, now)}
    shown = set()
    if dashboard.preflight and dashboard.maneuver.get("state") not in _DRIVING:
        parts["pre-flight"] = diagnostics_table(dashboard.preflight, now)
        shown = {name for name, e in dashboard.preflight.items() if now - e.heard <= SILENCE}
    entries = dashboard.diagnostics
    # a terminal of 24 lines has no room for what the pre-flight says already
    others = {name: entries[name] for name in sorted(entries) if name not in shown}
    if others or not shown:
        parts["diagnostics"] = diagnostics_table(others, now)
    return Group(
        news, *(Panel(part, title=name, title_align="left") for name, part in parts.items())
    )


def _maneuver(dashboard: Dashboard) -> RenderableType:
    values = dashboard.maneuver
    if not values:
        return Text("no maneuver_driver heard", style="dim")
    state = values.get("state", "")
    style = _STATE_STYLES.get(state, "")
    line = Text.assemble(
        (state, style),
        f"   plan {values.get('plan_id') or 'none'}",
        f"   {values.get('reason', '')}",
    )
    elapsed, duration = (_number(values.get(key)) for key in ("elapsed", "duration"))
    if state == PlaybackState.DONE.value and not values.get("reason"):
        elapsed = duration
    bar = Table.grid(padding=(0, 1), expand=True)
    bar.add_column(ratio=1)
    bar.add_column(justify="right")
    bar.add_row(
        ProgressBar(total=duration or 1.0, completed=elapsed),
        f"{elapsed:.1f} of {duration:.1f} s",
    )
    return Group(line, bar, *([Text(dashboard.learnt)] if dashboard.learnt else []))


class _WordByWord:
    """A table whose rows are running text where it would cut words: a cut number is a wrong one."""

    def __init__(self, table: Table, rows: Sequence[Text]) -> None:
        self._table, self._rows = table, rows

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        unlimited = options.update(max_width=1000)
        least = Measurement.get(console, unlimited, self._table).minimum
        yield self._table if least <= options.max_width else Group(*self._rows)


def _speeds(dashboard: Dashboard, now: float) -> RenderableType:
    """Return what was heard within `SILENCE`: an old speed is a wrong one."""

    def fresh(reading: Reading | None) -> Reading | None:
        return reading if reading is not None and now - reading.heard <= SILENCE else None

    odometry = fresh(dashboard.odometry)
    heads = ("speed m/s", "yaw rate rad/s", "steering motor rad", "rear wheel rad/s")
    moving = (f"{odometry.speed:.2f}", f"{odometry.yaw_rate:.3f}") if odometry else ("", "")
    rows = {
        name: (
            *(moving if name == "measured" else ("", "")),
            f"{joints.steering_motor_angle:.4f}" if joints else "–",
            f"{joints.wheel_rate:.3f}" if joints else "–",
        )
        for name, joints in (
            ("commanded", fresh(dashboard.commanded)),
            ("measured", fresh(dashboard.measured)),
        )
    }
    table = Table.grid(padding=(0, 2))  # five columns in a terminal of 80
    for _ in range(5):
        table.add_column(justify="right")
    table.add_row("", *heads)
    lines = []
    for name, cells in rows.items():
        table.add_row(name, *cells)
        told = (f"{head} {cell}" for head, cell in zip(heads, cells, strict=True) if cell)
        lines.append(Text(f"{name} {', '.join(told)}"))
    if odometry is not None:
        position = (f"{odometry.x:.2f} m", f"{odometry.y:.2f} m")
        table.add_row("position", *position)
        lines.append(Text(f"position {', '.join(position)}"))
    for column in table.columns:
        column.min_width = max(len(str(cell)) for cell in column.cells)
    return _WordByWord(table, lines)


def diagnostics_table(entries: Mapping[str, DiagnosticEntry], now: float) -> RenderableType:
    """Return entries as a table: what, how, and for how long it has been silent.

    Parameters
    ----------
    entries : mapping of str to DiagnosticEntry
        Entries by name, in the order of the rows.
    now : float
        Present time on the clock of the entries [s].
    """
    if not entries:
        return Text("none heard", style="dim")
    rows = []
    for name, entry in entries.items():
        age = now - entry.heard
        silent = age > SILENCE
        told = Text(entry.message, style="dim" if silent else _STYLES[entry.level])
        silence = Text(f"silent for {age:.0f} s" if silent else "", style="bold red")
        rows.append((Text(name), told, silence))
    table = Table.grid(padding=(0, 3))
    words = (len(word) for entry in entries.values() for word in entry.message.split())
    table.add_column(no_wrap=True, min_width=max(len(name) for name, _, _ in rows))
    table.add_column(min_width=max(words, default=0))
    table.add_column(no_wrap=True, min_width=max(len(silence) for _, _, silence in rows))
    for row in rows:
        table.add_row(*row)
    return _WordByWord(table, [Text(" ").join(filter(None, row)) for row in rows])


def _number(text: str | None) -> float:
    try:
        return float(text or 0.0)
    except ValueError:
        return 0.0
