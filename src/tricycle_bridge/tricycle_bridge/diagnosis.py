"""The state of the bridge and of both links as plain values, for /diagnostics."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from tricycle_bridge.arming import supply_problem
from tricycle_bridge.bridge import Bridge
from tricycle_bridge.commands.command_stream import Source
from tricycle_bridge.plc_link.link import DEGRADED_AGE, LinkState, PlcLink
from tricycle_bridge.protocol.messages import Fault, PlcState
from tricycle_bridge.protocol.readable import (
    firmware_version,
    readable_fields,
    state_and_faults,
)
from tricycle_bridge.protocol.units import VOLTAGE_UNIT
from tricycle_core.diagnostics import Level
from tricycle_core.namesakes import namesakes

# Names of the PLC's counters where that of the field does not say enough.
_PLC_COUNTERS = {
    "ok": "good frames",
    "crc": "CRC errors",
    "cobs": "COBS errors",
    "length": "length errors",
    "unknown": "unknown frames",
    "stale": "stale commands",
    "seq gap": "commands lost",
    "max tick (us)": "longest tick (us)",
    "duplicate": "duplicate frames",
    "version": "version errors",
    "session": "frames of another session",
}


@dataclass(frozen=True)
class Diagnosis:
    """State of one part, as in a DiagnosticStatus.

    Attributes
    ----------
    name : str
        Name of the part.
    level : Level
        Severity.
    message : str
        Summary in a line.
    values : dict of str to str
        Details by name, with units in the names.
    """

    name: str
    level: Level
    message: str
    values: dict[str, str]


def diagnose(
    bridge: Bridge, now: float, publishers: Mapping[Source, Sequence[str]] | None = None
) -> list[Diagnosis]:
    """Return the state of the vehicle and of each link.

    Parameters
    ----------
    bridge : Bridge
        Bridge with both links.
    now : float
        Present time on the bridge's clock [s].
    publishers : mapping of Source to sequence of str, optional
        Names of the nodes that publish on the commanders' topics, one for each publisher.
    """
    return [_diagnose_vehicle(bridge, now, publishers or {})] + [
        _diagnose_link(link, now) for link in bridge.links.values()
    ]


def _diagnose_vehicle(
    bridge: Bridge, now: float, publishers: Mapping[Source, Sequence[str]]
) -> Diagnosis:
    readiness = bridge.readiness(now)
    message = "armed" if readiness.armed else f"not armed: {readiness.reason}"
    level = Level.OK if readiness.armed else Level.WARN
    if problem := vehicle_problem(bridge, now):
        level, message = Level.ERROR, f"{message}; {problem}"
    elif alike := _indistinguishable(bridge, publishers):
        level, message = Level.WARN, f"{message}; {alike}"
    counters = bridge.commands.counters
    odometry, force = bridge.odometry.watching(now), bridge.start.watching(now)
    values = {
        "commander": readiness.commander,
        "commands accepted": str(counters.accepted),
        "commands too old": str(counters.stale),
        "commands refused": str(counters.refused),
        "wheel speed against odom": "watched" if odometry else "not watched: no odom",
        "first pulses against imu": "watched" if force else "not watched: no acceleration on imu",
    }
    return Diagnosis("tricycle_bridge: vehicle", level, message, values)


def _indistinguishable(bridge: Bridge, publishers: Mapping[Source, Sequence[str]]) -> str | None:
    """Say where several publish commands under one name or none: the bridge takes them for one."""
    if alike := namesakes(publishers.get(Source.JOINT_COMMANDS, ())):
        return f"{Source.JOINT_COMMANDS.value}: {alike}"
    last = bridge.commands.last_commander
    if last is None or last.name or (count := len(publishers.get(last.source, ()))) < 2:
        return None
    return f"{count} publishers of {last.source.value} that do not say who sends"


def vehicle_problem(bridge: Bridge, now: float) -> str | None:
    """Return a problem of the vehicle beyond its links: commanders or speeds that disagree.

    Parameters
    ----------
    bridge : Bridge
        Bridge with both links.
    now : float
        Present time on the bridge's clock [s].
    """
    return bridge.commands.conflict(now) or bridge.wheel_problem


def _diagnose_link(link: PlcLink, now: float) -> Diagnosis:
    name = f"tricycle_bridge: {link.board.plc_name}"
    values = _link_values(link)
    telemetry = link.telemetry
    if not link.up or telemetry is None:
        begun = (LinkState.BOOTING, LinkState.GREETING, LinkState.UP)
        waiting = link.state in begun and link.problem is None
        level = Level.WARN if waiting else Level.ERROR
        return Diagnosis(name, level, link.down_reason, values)

    age = link.telemetry_age(now)
    values["telemetry age (ms)"] = f"{age * 1e3:.0f}"
    values |= readable_fields(telemetry)
    message = state_and_faults(telemetry.state, telemetry.faults)
    if telemetry.state in (PlcState.ESTOP, PlcState.FAULT):
        return Diagnosis(name, Level.ERROR, message, values)
    if link.problem is not None:
        return Diagnosis(name, Level.ERROR, link.problem, values)
    if age > DEGRADED_AGE:
        return Diagnosis(name, Level.WARN, f"degraded: telemetry {age:.2f} s old", values)
    if (supply := supply_problem(link)) is not None:
        return Diagnosis(name, Level.WARN, f"{message}; {supply}", values)
    level = Level.WARN if telemetry.faults & ~Fault.LIMIT else Level.OK
    if link.identity is not None:
        message += f", firmware {firmware_version(link.identity)}"
    message += f", {telemetry.supply * VOLTAGE_UNIT:.1f} V"
    return Diagnosis(name, level, message, values)


def _link_values(link: PlcLink) -> dict[str, str]:
    decoder, counters = link.decoder.counters, link.counters
    values = {
        "link": link.state.value,
        "good frames": str(decoder.ok),
        "CRC errors": str(decoder.crc),
        "COBS errors": str(decoder.cobs),
        "length errors": str(decoder.length),
        "version errors": str(decoder.version),
        "unknown frames": str(decoder.unknown),
        "frames of another session": str(decoder.session),
        "frames lost": str(counters.seq_gaps),
        "duplicate frames": str(counters.duplicates),
        "frames sent": str(counters.sent),
        "writes dropped": str(counters.write_drops),
        "reboots": str(counters.reboots),
        "losses": str(counters.losses),
    }
    if link.identity is not None:
        # the recorder copies the value of this name to a bag's metadata
        values[f"firmware_{link.board.name.lower()}"] = firmware_version(link.identity)
    if link.clock.round_trip is not None:
        values["round trip (ms)"] = f"{link.clock.round_trip * 1e3:.1f}"
    if link.stats is not None:
        for counter, value in readable_fields(link.stats).items():
            values[f"PLC: {_PLC_COUNTERS.get(counter, counter)}"] = value
    return values
