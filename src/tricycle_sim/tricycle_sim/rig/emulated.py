"""The simulated tricycle: the live vehicle with its two emulated PLCs, tick by tick.

Bytes in, bytes and states out; ports, clocks and topics belong to the node that owns it.
"""

from dataclasses import dataclass

import numpy as np

from tricycle_bridge.protocol.boards import HALL_PULSE
from tricycle_bridge.protocol.messages import Board, PlcState
from tricycle_core.timing import TICK
from tricycle_sim.plc import DriveMeasurement, DrivePlc, Plc, SteerMeasurement, SteerPlc
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.live import LiveState, LiveVehicle

TICK_US = round(TICK * 1e6)


def draw_truth(vehicle: Vehicle, rng: np.random.Generator) -> dict[str, float]:
    """Hidden true values of the unknown parameters, uniform in their ranges."""
    return {name: float(rng.uniform(low, high)) for name, (low, high) in vehicle.unknown.items()}


class Simulator:
    """Vehicle, steer PLC and drive PLC on one clock that `step` moves on by 10 ms.

    Parameters
    ----------
    vehicle
        With its true values.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._steer = SteerPlc()
        self._drive = DrivePlc()
        self._ticks = 0
        self._boot_tick = 0
        self._live = LiveVehicle(vehicle)

    @property
    def time(self) -> float:
        """Simulated time in s; it never goes back."""
        return self._ticks * TICK

    @property
    def state(self) -> LiveState:
        """The vehicle's state at `time`."""
        return self._live.state

    @property
    def armed(self) -> bool:
        """Whether both PLCs are armed."""
        return self._steer.state is PlcState.ARMED and self._drive.state is PlcState.ARMED

    @property
    def answered(self) -> bool:
        """Whether both PLCs have accepted a command since the last step."""
        return all(self.heard(board) for board in self._plcs)

    def heard(self, board: Board) -> bool:
        """Whether a PLC has accepted a command since the last step."""
        return self._plcs[board].command_age(self._plc_time_us) == 0

    def reset(self) -> None:
        """Put the vehicle at rest at the origin and reboot both boards; time goes on."""
        self._live = LiveVehicle(self._vehicle)
        self._boot_tick = self._ticks
        for plc in self._plcs.values():
            plc.reset()

    def receive(self, board: Board, data: bytes) -> bytes:
        """Hand bytes of the host to a PLC; return its answers."""
        return self._plcs[board].receive(data, self._plc_time_us)

    def step(self) -> dict[Board, bytes]:
        """Run one tick: PLCs measure and control, the vehicle moves. Return the telemetry."""
        now, state = self._plc_time_us, self._live.state
        radius, voltage = self._vehicle.tyre_radius, self._vehicle.battery_voltage
        steer_bytes, steer = self._steer.tick(
            now,
            SteerMeasurement(
                angle=state.steering_motor_angle, rate=state.steering_motor_rate, supply=voltage
            ),
        )
        drive_bytes, drive = self._drive.tick(
            now,
            DriveMeasurement(
                speed=state.wheel_speeds[2] * radius,
                hall_count=int(state.rear_wheel_angle * radius / HALL_PULSE),
                torque=state.motor_torque,
                current=max(0.0, state.motor_current),
                supply=voltage,
            ),
        )
        self._live.step(
            steering=steer.setpoint if steer.servo_on else None,
            speed=drive.setpoint if drive.motor_on else None,
            brake=drive.brake,
        )
        self._ticks += 1
        return {Board.STEER: steer_bytes, Board.DRIVE: drive_bytes}

    def close(self) -> None:
        """Nothing is held that needs freeing; the firmware's simulator has something."""

    @property
    def _plcs(self) -> dict[Board, Plc]:  # type: ignore[type-arg]
        return {Board.STEER: self._steer, Board.DRIVE: self._drive}

    @property
    def _plc_time_us(self) -> int:
        """The boards' clock: it starts at their boot."""
        return (self._ticks - self._boot_tick) * TICK_US


@dataclass(frozen=True)
class PoseNoise:
    """White noise of a localisation, standard deviations."""

    position: float = 0.01  # m per axis
    yaw: float = 0.002  # rad
    speed: float = 0.01  # m/s
    yaw_rate: float = 0.005  # rad/s


@dataclass(frozen=True)
class MeasuredPose:
    """Planar pose and velocity of `base_link` in `odom`."""

    x: float  # m
    y: float  # m
    yaw: float  # rad
    vx: float  # m/s, base_link
    vy: float  # m/s, base_link
    yaw_rate: float  # rad/s


def measure_pose(state: LiveState, noise: PoseNoise, rng: np.random.Generator) -> MeasuredPose:
    """What a localisation with that noise would say of a state."""
    n = rng.standard_normal(6)
    return MeasuredPose(
        x=state.x + noise.position * n[0],
        y=state.y + noise.position * n[1],
        yaw=state.yaw + noise.yaw * n[2],
        vx=state.vx + noise.speed * n[3],
        vy=state.vy + noise.speed * n[4],
        yaw_rate=state.yaw_rate + noise.yaw_rate * n[5],
    )
