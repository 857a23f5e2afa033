"""What /diagnostics reports."""

import dataclasses

import pytest

from tricycle_bridge.commands.command_stream import Source
from tricycle_bridge.diagnosis import diagnose
from tricycle_bridge.protocol.messages import (
    Board,
    DriveState,
    Stats,
    SteerState,
    layout,
)
from tricycle_core.diagnostics import Level
from tricycle_sim.plc import DriveMeasurement, SteerMeasurement

STEER, DRIVE = Board.STEER, Board.DRIVE


def test_diagnostics_name_states_and_faults(driving):
    vehicle, steer, drive = diagnose(driving.bridge, driving.now)
    assert (vehicle.level, vehicle.message) == (Level.OK, "armed")
    assert (steer.level, steer.message) == (Level.OK, "ARMED, firmware 2.0.0, 12.0 V")
    assert steer.values["firmware_steer"].count(".") == 2  # copied to a bag's metadata
    driving.target = None
    driving.step(150)
    vehicle, steer, drive = diagnose(driving.bridge, driving.now)
    assert (vehicle.level, vehicle.message) == (
        Level.WARN,
        "not armed: waiting for the operator; stopped: steer PLC is STOPPING (CMD_TIMEOUT)",
    )
    assert (drive.level, drive.message) == (
        Level.WARN,
        "SAFE (CMD_TIMEOUT), firmware 2.0.0, 48.0 V",
    )
    assert drive.values["PLC: watchdog trips"] == "1"
    driving.bridge.closed(STEER, "/dev/x does not exist")
    _, steer, _ = diagnose(driving.bridge, driving.now)
    assert (steer.level, steer.message) == (Level.ERROR, "/dev/x does not exist")


def test_every_field_of_telemetry_and_every_counter_is_reported(driving):
    driving.step(100)  # until the next STATS
    _, steer, drive = diagnose(driving.bridge, driving.now)
    for diagnosis, state in ((steer, SteerState), (drive, DriveState)):
        for name in (*layout(state), *layout(Stats)):
            label = name.replace("_", " ")
            assert sum(label in key for key in diagnosis.values) or name in _LABELS, label
        assert sum(key.startswith("PLC: ") for key in diagnosis.values) == len(layout(Stats))
    assert drive.values["speed (m/s)"] == "1.000"
    assert drive.values["gear"] == "DRIVE"
    assert steer.values["angle (rad)"] == "0.2000"
    assert float(drive.values["supply (V)"]) == 48.0
    assert (drive.values["state"], drive.values["faults"]) == ("ARMED", "")
    assert drive.values["PLC: stale commands"] == "0"


# names of counters whose label is not that of the field
_LABELS = {"ok", "crc", "cobs", "length", "unknown", "seq_gap", "max_tick", "version"}


def test_a_limit_is_no_warning_and_a_fault_is_an_error(driving):
    driving.target = (2.0, 1.0)  # beyond the largest angle
    driving.step(20)
    _, steer, _ = diagnose(driving.bridge, driving.now)
    assert (steer.level, steer.message) == (Level.OK, "ARMED, firmware 2.0.0, 12.0 V")
    driving.measured[STEER] = SteerMeasurement(0.2, adc=2)
    driving.step(2)
    _, steer, _ = diagnose(driving.bridge, driving.now)
    assert (steer.level, steer.message) == (Level.ERROR, "FAULT (SENSOR)")
    driving.measured[DRIVE] = DriveMeasurement(estop_pressed=True)
    driving.step(2)
    _, _, drive = diagnose(driving.bridge, driving.now)
    assert (drive.level, drive.message) == (Level.ERROR, "ESTOP (ESTOP_HW)")


def test_old_telemetry_is_degraded_then_lost(driving):
    driving.cut.add(DRIVE)
    driving.step(15)
    _, _, drive = diagnose(driving.bridge, driving.now)
    assert (drive.level, drive.message) == (Level.WARN, "degraded: telemetry 0.15 s old")
    driving.step(30)
    _, _, drive = diagnose(driving.bridge, driving.now)
    assert drive.level is Level.ERROR
    assert drive.message.startswith("no telemetry for")


def test_a_port_that_was_just_opened_is_a_warning(vehicle):
    vehicle.bridge.closed(STEER, "unplugged")
    vehicle.bridge.opened(STEER, vehicle.now)
    _, steer, _ = diagnose(vehicle.bridge, vehicle.now)
    assert (steer.level, steer.message) == (Level.WARN, "waiting for the bootloader")


def test_the_vehicle_waits_for_the_operator(vehicle):
    state = diagnose(vehicle.bridge, vehicle.now)[0]
    assert (state.level, state.message) == (Level.WARN, "not armed: waiting for the operator")
    assert int(state.values["commands accepted"]) == pytest.approx(20)


def test_commanders_of_one_name_are_told(driving):
    publishers = {Source.JOINT_COMMANDS: ["/maneuver_driver"]}
    assert diagnose(driving.bridge, driving.now, publishers)[0].level is Level.OK
    publishers[Source.JOINT_COMMANDS] *= 2
    vehicle = diagnose(driving.bridge, driving.now, publishers)[0]
    assert vehicle.level is Level.WARN
    assert vehicle.message.startswith("armed; joint_commands: /maneuver_driver runs 2 times: end")


def test_what_the_wheel_is_compared_with_is_told(driving):
    def told():
        values = diagnose(driving.bridge, driving.now)[0].values
        return values["wheel speed against odom"], values["first pulses against imu"]

    assert told() == ("not watched: no odom", "not watched: no acceleration on imu")
    driving.bridge.set_force(0.1, driving.now)
    assert told()[1] == "watched"
    driving.step(30)
    assert told()[1] == "not watched: no acceleration on imu"


def test_a_supply_outside_its_thresholds_is_a_warning(vehicle):
    vehicle.measured[DRIVE] = DriveMeasurement(supply=31.5)
    vehicle.step()
    *_, drive = diagnose(vehicle.bridge, vehicle.now)
    assert drive.level is Level.WARN
    assert drive.message.endswith("drive PLC: supply is 31.5 V, must be at least 40.0 V")


def test_a_refused_setup_is_an_error(vehicle):
    link = vehicle.bridge.links[STEER]
    link.setup = dataclasses.replace(link.setup, max_rate=4000)
    vehicle.plcs[STEER].reset()
    vehicle.step(50)
    _, steer, _ = diagnose(vehicle.bridge, vehicle.now)
    assert (steer.level, steer.message) == (
        Level.ERROR,
        "steer PLC refused its set-up: out of range: "
        "max_rate 4.000 rad/s, the board allows 3.000 rad/s",
    )
    assert steer.message in vehicle.warnings
