"""What /diagnostics says about each board, as plain values."""

from __future__ import annotations

from dataclasses import dataclass

from tricycle_bridge.bridge import Bridge
from tricycle_bridge.link import DEGRADED_AGE, LinkState, state_name
from tricycle_bridge.protocol.messages import Board, Fault, PlcState, fault_names
from tricycle_core.diagnostics import Level


@dataclass(frozen=True)
class Diagnosis:
    """One line for a person, and values for the curious."""

    name: str
    level: Level
    message: str
    values: dict[str, str]


def diagnose(bridge: Bridge, now: float) -> list[Diagnosis]:
    """Describe the whole bridge and each link at `now` (s)."""
    return [_diagnose_bridge(bridge, now)] + [
        _diagnose_link(bridge, board, now) for board in bridge.links
    ]


def _diagnose_bridge(bridge: Bridge, now: float) -> Diagnosis:
    values = {
        "commands accepted": str(bridge.counters.accepted),
        "commands too old": str(bridge.counters.stale),
        "commands refused": str(bridge.counters.refused),
    }
    if bridge.armed:
        return Diagnosis("tricycle_bridge: vehicle", Level.OK, "armed", values)
    reason = bridge.refusal(now)
    message = f"not armed: {reason}" if reason else "not armed: waiting for the operator"
    return Diagnosis("tricycle_bridge: vehicle", Level.WARN, message, values)


def _diagnose_link(bridge: Bridge, board: Board, now: float) -> Diagnosis:
    link = bridge.links[board]
    decoder, counters, telemetry = link.decoder.counters, link.counters, link.telemetry
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
    if (ack := link.identity) is not None:
        version = f"{ack.version_major}.{ack.version_minor}.{ack.version_patch}"
        values[f"firmware_{board.name.lower()}"] = version  # the recorder looks for it
    if link.clock.round_trip is not None:
        values["round trip (ms)"] = f"{link.clock.round_trip * 1e3:.1f}"
    if link.stats is not None:
        values["PLC: stale commands"] = str(link.stats.stale)
        values["PLC: CRC errors"] = str(link.stats.crc)
        values["PLC: commands lost"] = str(link.stats.seq_gap)
        values["PLC: watchdog trips"] = str(link.stats.watchdog_trips)
        values["PLC: longest tick (us)"] = str(link.stats.max_tick)
    name = f"tricycle_bridge: {board.name.lower()} PLC"
    if not link.up or telemetry is None:
        begun = (LinkState.BOOTING, LinkState.GREETING, LinkState.UP)
        waiting = link.state in begun and not link.problem
        level = Level.WARN if waiting else Level.ERROR
        return Diagnosis(name, level, link.trouble, values)

    age = link.telemetry_age(now)
    faults = fault_names(telemetry.faults)
    values["state"] = state_name(telemetry.state)
    values["faults"] = faults
    values["telemetry age (ms)"] = f"{age * 1e3:.0f}"
    values["supply (V)"] = f"{telemetry.supply * 1e-3:.1f}"
    message = values["state"] + (f" ({faults})" if faults else "")
    if telemetry.state in (PlcState.ESTOP, PlcState.FAULT):
        return Diagnosis(name, Level.ERROR, message, values)
    if age > DEGRADED_AGE:
        return Diagnosis(name, Level.WARN, f"degraded: telemetry {age:.2f} s old", values)
    level = Level.WARN if telemetry.faults & ~Fault.LIMIT else Level.OK
    return Diagnosis(name, level, message, values)
