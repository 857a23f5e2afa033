"""Values of messages as text for a person."""

from __future__ import annotations

import enum
import math

from tricycle_bridge.protocol.messages import (
    Fault,
    HelloAck,
    Message,
    PlcState,
    ResetCause,
    Unit,
    meanings,
)


def readable_fields(message: Message) -> dict[str, str]:
    """Return the fields of a message with their units, e.g. ``{"speed (m/s)": "1.003"}``.

    Reserved fields are left out.

    Parameters
    ----------
    message : Message
        Message of any type.

    Examples
    --------
    >>> from tricycle_bridge.protocol.messages import Ack, Event
    >>> readable_fields(Ack(1, 3, 4, 2))
    {'op': 'ARM', 'ctrl seq': '3', 'result': 'PRECONDITIONS', 'state': 'ARMED'}
    >>> readable_fields(Event(1_500_000, 1, 0x12, 0x101))["t (s)"]
    '1.500000'
    """
    texts = {}
    for name, meaning in meanings(type(message)).items():
        value = getattr(message, name)
        label = name.replace("_", " ")
        if name.startswith("reserved"):
            continue
        if isinstance(meaning, Unit):
            texts[f"{label} ({meaning.symbol})"] = _in_units(value, meaning)
        elif meaning is None:
            texts[label] = str(value)
        elif issubclass(meaning, enum.IntFlag):
            texts[label] = _flag_names(meaning, value)
        else:
            texts[label] = _name_of(meaning, value)
    return texts


def readable_value(message: Message, name: str) -> str:
    """Return the value of a field that has a unit, e.g. ``4.800 m/s``.

    Parameters
    ----------
    message : Message
        Message of any type.
    name : str
        Name of the field.
    """
    meaning = meanings(type(message))[name]
    if not isinstance(meaning, Unit):
        return str(getattr(message, name))
    return f"{_in_units(getattr(message, name), meaning)} {meaning.symbol}"


def fault_names(faults: int) -> str:
    """Return the names of fault bits; empty without faults.

    Parameters
    ----------
    faults : int
        Bits of `Fault`.

    Examples
    --------
    >>> fault_names(0x101)
    'CMD_TIMEOUT|LIMIT'
    >>> fault_names(0x1000)
    'BIT_12'
    """
    return _flag_names(Fault, faults)


_FAULT_CAUSES = {
    Fault.PULSES: "motor torque without pulses: wheel blocked, or hall or direction sensor broken",
    Fault.SUPPLY: "supply outside its thresholds",
    Fault.STOP_TIMEOUT: "the vehicle did not come to rest in time: brake or hall sensor broken",
    Fault.HALL_LINE: "hall or direction wire broken or shorted",
}


def state_and_faults(state: int, faults: int) -> str:
    """Return a PLC's state and its faults, with what those mean whose names do not say it.

    Parameters
    ----------
    state : int
        Value of `PlcState`.
    faults : int
        Bits of `Fault`.

    Examples
    --------
    >>> state_and_faults(5, 0x204)
    'FAULT (SENSOR|SUPPLY): supply outside its thresholds'
    """
    names = fault_names(faults)
    causes = "; ".join(text for fault, text in _FAULT_CAUSES.items() if faults & fault)
    return state_name(state) + (f" ({names})" if names else "") + (f": {causes}" if causes else "")


def state_name(state: int) -> str:
    """Return the name of a PLC state, also of one that a newer minor version added.

    Parameters
    ----------
    state : int
        Value of `PlcState`.

    Examples
    --------
    >>> state_name(2), state_name(9)
    ('ARMED', 'UNKNOWN_9')
    """
    return _name_of(PlcState, state)


def reset_cause_name(cause: int) -> str:
    """Return the name of a reset cause.

    Parameters
    ----------
    cause : int
        Value of `ResetCause`.

    Examples
    --------
    >>> reset_cause_name(1)
    'power-on'
    """
    return _name_of(ResetCause, cause).lower().replace("_", "-")


def firmware_version(identity: HelloAck) -> str:
    """Return the version of a PLC's firmware, e.g. ``1.0.0``.

    Parameters
    ----------
    identity : HelloAck
        The PLC's answer to HELLO.
    """
    return f"{identity.version_major}.{identity.version_minor}.{identity.version_patch}"


def firmware_build(identity: HelloAck) -> str:
    """Return version and build of a PLC's firmware, e.g. ``2.0.0 (1f00a9c3)``.

    Parameters
    ----------
    identity : HelloAck
        The PLC's answer to HELLO.
    """
    return f"{firmware_version(identity)} ({identity.build_hash:08x})"


def _in_units(value: int, unit: Unit) -> str:
    decimals = max(0, math.ceil(-math.log10(unit.scale)))
    return f"{value * unit.scale:.{decimals}f}"


def _name_of(kind: type[enum.IntEnum], value: int) -> str:
    try:
        return kind(value).name
    except ValueError:
        return f"UNKNOWN_{value}"


def _flag_names(kind: type[enum.IntFlag], value: int) -> str:
    known = {flag.value: flag.name for flag in kind}
    return "|".join(known.get(1 << bit) or f"BIT_{bit}" for bit in range(16) if value & (1 << bit))
