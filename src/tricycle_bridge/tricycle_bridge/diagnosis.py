"""The state of the bridge and of both links as plain values, for /diagnostics."""

from __future__ import annotations

from dataclasses import dataclass

from tricycle_bridge.bridge import Bridge
from tricycle_bridge.link import DEGRADED_AGE, LinkState, PlcLink
from tricycle_bridge.protocol.messages import Fault, PlcState
from tricycle_bridge.protocol.readable import (
    fault_names,
    firmware_version,
    readable_fields,
    state_name,
)
from tricycle_core.diagnostics import Level

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
        How it is.
    message : str
        Summary in a line.
    values : dict of str to str
        Details by name, with units in the names.
    """

    name: str
    level: Level
    message: str
    values: dict[str, str]


def diagnose(bridge: Bridge, now: float) -> list[Diagnosis]:
    """Return the state of the vehicle and of each link.

    Parameters
    ----------
    bridge : Bridge
        The bridge.
    now : float
        Present time on the host's clock [s].
    """
    return [_diagnose_vehicle(bridge, now)] + [
        _diagnose_link(link, now) for link in bridge.links.values()
    ]


def _diagnose_vehicle(bridge: Bridge, now: float) -> Diagnosis:
    counters = bridge.commands.counters
    values = {
        "commands accepted": str(counters.accepted),
        "commands too old": str(counters.stale),
        "commands refused": str(counters.refused),
    }
    if bridge.armed:
        return Diagnosis("tricycle_bridge: vehicle", Level.OK, "armed", values)
    reason = bridge.refusal(now) or "waiting for the operator"
    return Diagnosis("tricycle_bridge: vehicle", Level.WARN, f"not armed: {reason}", values)


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
    faults = fault_names(telemetry.faults)
    message = state_name(telemetry.state) + (f" ({faults})" if faults else "")
    if telemetry.state in (PlcState.ESTOP, PlcState.FAULT):
        return Diagnosis(name, Level.ERROR, message, values)
    if age > DEGRADED_AGE:
        return Diagnosis(name, Level.WARN, f"degraded: telemetry {age:.2f} s old", values)
    level = Level.WARN if telemetry.faults & ~Fault.LIMIT else Level.OK
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
