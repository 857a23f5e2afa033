"""What a live run looks like in a terminal: links, maneuver, speeds, progress."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from tricycle_core.diagnostics import Level

SILENCE = 3.0  # s after which a source counts as silent; diagnostics come once a second


_STYLES = {Level.OK: "green", Level.WARN: "yellow", Level.ERROR: "bold red", Level.STALE: "dim"}


@dataclass(frozen=True)
class Status:
    """One entry of the diagnostics."""

    level: Level
    message: str
    heard: float  # s, clock of the dashboard


@dataclass(frozen=True)
class Joints:
    """Angle of the steering motor, rad, and rate of the rear wheel, rad/s."""

    steering_motor_angle: float
    wheel_rate: float


@dataclass(frozen=True)
class Motion:
    """Pose and speed in `odom`."""

    x: float  # m
    y: float  # m
    speed: float  # m/s, forward positive
    yaw_rate: float  # rad/s, left positive


@dataclass
class Dashboard:
    """What was heard last of each source; None and empty where nothing was.

    Attributes
    ----------
    statuses
        Entry of the diagnostics by its name, `node: part`.
    maneuver
        Values of `maneuver/state`.
    """

    statuses: dict[str, Status] = field(default_factory=dict)
    maneuver: Mapping[str, str] = field(default_factory=dict)
    commanded: Joints | None = None
    measured: Joints | None = None
    motion: Motion | None = None
    heard: float | None = None  # s, of the newest message of any kind

    def snapshot(self) -> dict[str, object]:
        """The same as JSON values."""
        return {
            "maneuver": dict(self.maneuver),
            "diagnostics": {
                name: {"level": status.level.name.lower(), "message": status.message}
                for name, status in self.statuses.items()
            },
            "commanded": self.commanded and vars(self.commanded),
            "measured": self.measured and vars(self.measured),
            "odom": self.motion and vars(self.motion),
        }


def screen(dashboard: Dashboard, *, now: float, where: str) -> RenderableType:
    """Draw the dashboard at `now` (s); `where` says which domain and namespace it is of."""
    if dashboard.heard is None:
        news = Text(f"{where}: nothing heard yet", style="yellow")
    elif now - dashboard.heard > SILENCE:
        news = Text(f"{where}: silent for {now - dashboard.heard:.0f} s", style="bold red")
    else:
        news = Text(where)
    return Group(
        news,
        Panel(_maneuver(dashboard.maneuver), title="maneuver", title_align="left"),
        Panel(_speeds(dashboard), title="motion", title_align="left"),
        Panel(_statuses(dashboard.statuses, now), title="diagnostics", title_align="left"),
    )


def _maneuver(values: Mapping[str, str]) -> RenderableType:
    if not values:
        return Text("no maneuver_driver heard", style="dim")
    state = values.get("state", "")
    style = {"running": "bold cyan", "done": "green", "aborted": "bold red"}.get(state, "")
    line = Text.assemble(
        (state, style),
        f"   plan {values.get('plan_id') or 'none'}",
        f"   {values.get('reason', '')}",
    )
    elapsed, duration = (_number(values.get(key)) for key in ("elapsed", "duration"))
    if state == "done":
        elapsed = duration
    bar = Table.grid(padding=(0, 1), expand=True)
    bar.add_column(ratio=1)
    bar.add_column(justify="right")
    bar.add_row(
        ProgressBar(total=duration or 1.0, completed=elapsed),
        f"{elapsed:.1f} of {duration:.1f} s",
    )
    return Group(line, bar)


def _speeds(dashboard: Dashboard) -> RenderableType:
    table = Table.grid(padding=(0, 3))
    for _ in range(5):
        table.add_column(justify="right")
    table.add_row("", "speed m/s", "yaw rate rad/s", "steering motor rad", "rear wheel rad/s")
    for name, joints in (("commanded", dashboard.commanded), ("measured", dashboard.measured)):
        motion = dashboard.motion if name == "measured" else None
        table.add_row(
            name,
            f"{motion.speed:.2f}" if motion else "",
            f"{motion.yaw_rate:.3f}" if motion else "",
            f"{joints.steering_motor_angle:.4f}" if joints else "–",
            f"{joints.wheel_rate:.3f}" if joints else "–",
        )
    if dashboard.motion is not None:
        table.add_row("position", f"{dashboard.motion.x:.2f} m", f"{dashboard.motion.y:.2f} m")
    return table


def _statuses(statuses: Mapping[str, Status], now: float) -> RenderableType:
    if not statuses:
        return Text("none heard", style="dim")
    table = Table.grid(padding=(0, 3))
    for name in sorted(statuses):
        status = statuses[name]
        age = now - status.heard
        silent = age > SILENCE
        table.add_row(
            name,
            Text(status.message, style="dim" if silent else _STYLES[status.level]),
            Text(f"silent for {age:.0f} s", style="bold red") if silent else "",
        )
    return table


def _number(text: str | None) -> float:
    try:
        return float(text or 0.0)
    except ValueError:
        return 0.0
