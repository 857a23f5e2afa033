"""Messages as text."""

import pytest

from tricycle_bridge.protocol.messages import MESSAGES, DriveState, Fault, Gear, PlcState, layout
from tricycle_bridge.protocol.readable import (
    fault_names,
    readable_fields,
    reset_cause_name,
    state_and_faults,
    state_name,
)


@pytest.mark.parametrize("kind", MESSAGES)
def test_every_field_but_the_reserved_ones_has_a_text(kind):
    message = kind(**dict.fromkeys(layout(kind), 1))
    fields = [name for name in layout(kind) if not name.startswith("reserved")]
    assert [key.partition(" (")[0].replace(" ", "_") for key in readable_fields(message)] == fields


def test_values_are_in_si_units_and_enumerations_by_name():
    values = dict.fromkeys(layout(DriveState), 0) | {
        "state": PlcState.ARMED,
        "flags": 0b101,
        "faults": 1 << 12 | 1,
        "speed": -1003,
        "hall_count": -7,
        "current": 1234,
        "supply": 48_000,
        "gear": Gear.REVERSE,
        "brake": 1,
    }
    texts = readable_fields(DriveState(**values))
    assert texts["state"] == "ARMED"
    assert texts["flags"] == "ENABLED|LIMITED"
    assert texts["faults"] == "CMD_TIMEOUT|BIT_12"
    assert texts["speed (m/s)"] == "-1.003"
    assert texts["hall count"] == "-7"
    assert texts["current (A)"] == "1.234"
    assert texts["supply (V)"] == "48.000"
    assert texts["gear"] == "REVERSE"
    assert texts["brake (%)"] == "0.5"


def test_what_a_newer_minor_version_added_has_a_name_too():
    assert fault_names(1 << 12) == "BIT_12"
    assert state_name(9) == "UNKNOWN_9"
    assert reset_cause_name(16) == "unknown-16"


def test_faults_whose_names_say_little_are_explained():
    assert state_and_faults(PlcState.FAULT, Fault.PULSES) == (
        "FAULT (PULSES): "
        "motor torque without pulses: wheel blocked, or hall or direction sensor broken"
    )
    assert state_and_faults(PlcState.FAULT, Fault.SENSOR) == "FAULT (SENSOR)"
    assert state_and_faults(PlcState.SAFE, 0) == "SAFE"
