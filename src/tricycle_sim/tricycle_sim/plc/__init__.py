"""The two PLCs, emulated: the counterpart of `firmware/`."""

from tricycle_sim.plc.plc import (
    DriveMeasurement,
    DriveOutput,
    DrivePlc,
    Plc,
    SteerMeasurement,
    SteerOutput,
    SteerPlc,
)

__all__ = [
    "DriveMeasurement",
    "DriveOutput",
    "DrivePlc",
    "Plc",
    "SteerMeasurement",
    "SteerOutput",
    "SteerPlc",
]
