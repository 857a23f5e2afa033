"""Recordings of other systems as bags: what was measured comes out as it went in."""

import dataclasses

import numpy as np
import pytest
from simulated_drives import VEHICLE, commands_of_pair, driven

from parameter_identification.drives.imported import recording_of, write_bag
from parameter_identification.drives.measured import Sensor, read_measured_drive
from parameter_identification.drives.simulated import SensorNoise
from parameter_identification.drives.table import SteeringMap

ALL = {sensor: SensorNoise(1e-3, rate=50.0) for sensor in Sensor}


@pytest.fixture(scope="module")
def drive():
    return driven(commands_of_pair()["lane"], noise=0.01, others=ALL.items(), standstill=1.0)


def test_a_bag_holds_every_sensor_of_the_recording(drive, tmp_path):
    start = write_bag(recording_of(drive), VEHICLE, SteeringMap(), tmp_path / "bag")
    again = read_measured_drive(tmp_path / "bag", VEHICLE)
    assert again.signals.keys() == drive.signals.keys() == set(Sensor)
    assert again.signals[Sensor.WHEEL_SPEEDS].wheels == ("left", "right", "rear")
    begin = float(drive.signals[Sensor.POSITION].time[0]) + start
    for sensor, signal in again.signals.items():
        at = np.searchsorted(drive.signals[sensor].time - begin, signal.time - 1e-6)
        np.testing.assert_allclose(signal.values, drive.signals[sensor].values[at], atol=1e-9)


def test_what_was_not_measured_is_not_in_the_bag(drive, tmp_path):
    few = {s: drive.signals[s] for s in (Sensor.POSITION, Sensor.YAW_RATE, Sensor.WHEEL_SPEED)}
    recording = recording_of(dataclasses.replace(drive, signals=few))
    write_bag(recording, VEHICLE, SteeringMap(), tmp_path / "bag")
    assert read_measured_drive(tmp_path / "bag", VEHICLE).signals.keys() == few.keys()
