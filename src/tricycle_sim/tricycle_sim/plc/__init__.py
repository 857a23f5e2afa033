"""The two PLCs, emulated: the counterpart of `firmware/`, module by module."""

from tricycle_sim.plc.drive import DriveMeasurement, DriveOutput, DrivePlc
from tricycle_sim.plc.plc import Plc
from tricycle_sim.plc.steer import SteerMeasurement, SteerOutput, SteerPlc

__all__ = [
    "DriveMeasurement",
    "DriveOutput",
    "DrivePlc",
    "Plc",
    "SteerMeasurement",
    "SteerOutput",
    "SteerPlc",
]
