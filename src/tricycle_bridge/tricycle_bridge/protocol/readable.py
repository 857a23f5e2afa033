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
        Any message.

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
            decimals = max(0, math.ceil(-math.log10(meaning.scale)))
            texts[f"{label} ({meaning.symbol})"] = f"{value * meaning.scale:.{decimals}f}"
        elif meaning is None:
            texts[label] = str(value)
        elif issubclass(meaning, enum.IntFlag):
            texts[label] = _flag_names(meaning, value)
        else:
            texts[label] = _name_of(meaning, value)
    return texts


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
    >>> fault_names(0x200)
    'BIT_9'
    """
    return _flag_names(Fault, faults)


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
        What the PLC answered to HELLO.
    """
    return f"{identity.version_major}.{identity.version_minor}.{identity.version_patch}"


def _name_of(kind: type[enum.IntEnum], value: int) -> str:
    try:
        return kind(value).name
    except ValueError:
        return f"UNKNOWN_{value}"


def _flag_names(kind: type[enum.IntFlag], value: int) -> str:
    known = {flag.value: flag.name for flag in kind}
    return "|".join(known.get(1 << bit) or f"BIT_{bit}" for bit in range(16) if value & (1 << bit))
