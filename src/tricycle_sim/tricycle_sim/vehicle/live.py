"""One vehicle that is driven tick by tick: what the emulated PLCs and the simulation node own.

It runs the compiled functions of the batch, with two Runge-Kutta steps per tick instead of one.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tricycle_bridge.protocol.limits import MAX_SPEED
from tricycle_core.poses import Pose
from tricycle_core.quantities import FloatArray
from tricycle_core.rotations import pitch_angle, roll_angle, yaw_angle
from tricycle_core.timing import TICK
from tricycle_sim.vehicle.body import BODY
from tricycle_sim.vehicle.constants import Vehicle
from tricycle_sim.vehicle.feasibility import Feasibility, read_feasibility
from tricycle_sim.vehicle.groups import equilibrium, pack, sample_values
from tricycle_sim.vehicle.kernel import COMMAND, NO_OUTPUT, NO_ROWS, functions_for
from tricycle_sim.vehicle.layout import (
    ALIVE,
    EVALUATED,
    LANES,
    SLOPE,
    STATE,
    WHEEL_EVALUATED,
    WHEEL_STATES,
    numbered,
    of_wheels,
)
from tricycle_sim.vehicle.parts import (
    BLOCK,
    WHEEL,
    WHEEL_ROWS,
    servo_at_rest,
    steering_constants,
    structure_of,
)
from tricycle_sim.vehicle.sensing import relative_spin, specific_force
from tricycle_sim.vehicle.stability import check_step, lengthen_relaxation

ORIGIN: Pose = (0.0, 0.0, 0.0)
_BODY = numbered(BODY, first=BLOCK.body)


@dataclass(frozen=True)
class LiveState:
    """Readings of ideal instruments at a tick. Body frame: origin at the COM, REP-103."""

    time: float  # s since the start
    x: float  # m, COM in the world
    y: float
    z: float
    quaternion: tuple[float, float, float, float]  # (w, x, y, z), body to world
    roll: float  # rad, ZYX angles
    pitch: float
    yaw: float
    vx: float  # m/s, body frame
    vy: float
    vz: float
    roll_rate: float  # rad/s, body frame
    pitch_rate: float
    yaw_rate: float
    specific_force: tuple[float, float, float]  # m/s^2, body frame: what an accelerometer reads
    wheel_speeds: tuple[float, ...]  # rad/s, relative to the body, in the order of the wheels
    drive_speed: float  # rad/s, of the motor relative to the body: mean of the driven wheels
    drive_angle: float  # rad, turned by the motor since the start (hall pulses)
    steering_motor_angle: float  # rad
    steering_motor_rate: float  # rad/s
    loads: tuple[float, ...]  # N, in the order of the wheels
    motor_torque: float  # N m
    motor_power: float  # W, electrical, estimated; negative: regenerating
    motor_current: float  # A, at the battery
    rolled_over: bool  # the vehicle is at rest where it is from then on


class LiveVehicle:
    """A vehicle at rest that `step` moves by one PLC tick of 10 ms.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle; its unknown parameters take the values of `parameters`.
    parameters : ndarray of float, shape (k,), optional
        Values of `vehicle.unknown` in its order; by default the nominal ones.
    substeps : int
        Runge-Kutta steps per tick; 1 is what batches do.
    start : (float, float, float)
        Pose at the beginning: x, y [m] and heading [rad].

    Raises
    ------
    VehicleError
        If the vehicle is too stiff for the steps.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        *,
        parameters: ArrayLike | None = None,
        substeps: int = 2,
        start: Pose = ORIGIN,
    ) -> None:
        point = vehicle.nominal_point() if parameters is None else np.asarray(parameters, float)
        if point.shape != (len(vehicle.unknown),):
            raise ValueError(
                f"parameters: shape {point.shape} instead of ({len(vehicle.unknown)},)"
            )
        check_step(vehicle, TICK / substeps)
        self.vehicle = vehicle
        self._substeps = substeps
        self._functions = functions_for(vehicle)
        self._groups = pack(vehicle, point[np.newaxis], equilibrium(vehicle))
        # which set-points are to come is not known
        lengthen_relaxation(self._groups, vehicle, MAX_SPEED, TICK / substeps)
        self._rows = self._groups.reshape(-1, LANES)
        self._place(*start)
        self._constants = steering_constants(
            vehicle, 0.5 * TICK / substeps, sample_values(vehicle, point)
        )
        self._servo = servo_at_rest(vehicle)
        self._table = np.empty((2 * substeps + 1, 8))
        self._angles = np.empty((2, 2))
        self._lag = np.zeros(2)
        self._drive = np.zeros((2, 3))
        self._ticks = 0
        self._sides = structure_of(vehicle).sides
        self._shares = self._rows[
            of_wheels(WHEEL.torque_share, WHEEL_ROWS, len(vehicle.wheels)), 0
        ].tolist()
        self._drive_angle = 0.0
        self._drive_speed = 0.0
        self._steer(np.empty(0), 0)
        self._table[1:] = self._table[0]  # the last row is read at rest too
        # the first state has its loads and slopes too
        self._advance(self._table[:1], self._drive[:1])
        self._state = self._read()

    @property
    def state(self) -> LiveState:
        """The state at the present tick."""
        return self._state

    @property
    def feasibility(self) -> Feasibility:
        """Limits that the vehicle has reached so far; arrays of shape (1,)."""
        return read_feasibility(self._groups, 1, self.vehicle.wheels)

    def step(
        self,
        *,
        steering: float | None = None,
        speed: float | None = None,
        torque: float = 0.0,
        brake: float = 0.0,
    ) -> LiveState:
        """Hold set-points for one tick of 10 ms and return the state after it.

        Set-points come slewed (`tricycle_sim.setpoints.slew`): that is the PLC's part.

        Parameters
        ----------
        steering : float or None
            Motor angle [rad]; None: no servo pulse, the gear holds the angle.
        speed : float or None
            Speed mode: rear wheel speed times tyre radius [m/s], negative backwards. None: torque
            mode.
        torque : float
            Torque mode: demand on the motor [N m], limited as the motor is.
        brake : float
            Share 0 to 1 of the friction brake.
        """
        speed_mode = speed is not None
        if speed_mode and self._drive[0, COMMAND.speed_mode] == 0.0:
            self._rows[STATE.integrator] = 0.0  # the controller starts anew
        self._drive[:] = (speed_mode, torque if speed is None else speed, brake)
        setpoint = np.array([math.nan if steering is None else steering])
        self._steer(setpoint, 2 * self._substeps)
        self._advance(self._table, self._drive)
        self._ticks += 1
        self._state = self._read()
        return self._state

    def _place(self, x: float, y: float, heading: float) -> None:
        """Move the vehicle at rest to a pose."""
        c, s = math.cos(0.5 * heading), math.sin(0.5 * heading)
        q0, q1, q2, q3 = self._rows[STATE.q0 : STATE.q3 + 1].copy()
        turned = (c * q0 - s * q3, c * q1 - s * q2, c * q2 + s * q1, c * q3 + s * q0)
        self._rows[STATE.x], self._rows[STATE.y] = self._rows[STATE.x] + x, self._rows[STATE.y] + y
        self._rows[STATE.q0 : STATE.q3 + 1] = turned

    def _steer(self, setpoints: FloatArray, half_steps: int) -> None:
        self._functions.steer(
            self._servo, setpoints, self._constants, half_steps, self._table, self._angles
        )

    def _advance(self, table: FloatArray, drive: FloatArray) -> None:
        self._functions.advance(
            self._groups,
            table,
            self._lag,
            drive,
            self._substeps,
            self._ticks,
            NO_ROWS,
            1,
            NO_OUTPUT,
        )

    def _read(self) -> LiveState:
        values: FloatArray = self._rows[:, 0]
        x, y, z, *quaternion = values[: STATE.q3 + 1].tolist()
        attitude = tuple(quaternion)
        velocity = tuple(values[STATE.u : STATE.w + 1].tolist())
        rates = tuple(values[STATE.p : STATE.r + 1].tolist())
        wheels = len(self.vehicle.wheels)
        spins = values[of_wheels(STATE.spin, WHEEL_STATES, wheels)].tolist()
        slopes = values[SLOPE + STATE.u : SLOPE + STATE.w + 1].tolist()
        axles = self._table[-1].tolist()
        wheel_speeds = tuple(
            relative_spin(spin, rates, None if side < 0 else axles[4 * side : 4 * side + 3])
            for spin, side in zip(spins, self._sides[:wheels], strict=True)
        )
        drive_speed = sum(a * b for a, b in zip(self._shares, wheel_speeds, strict=True))
        self._drive_angle += 0.5 * TICK * (self._drive_speed + drive_speed)
        self._drive_speed = drive_speed
        gravity = values[[_BODY.gravity_x, _BODY.gravity_y, _BODY.gravity_z]].tolist()
        torque = float(values[STATE.torque])
        power = torque * drive_speed + self.vehicle.motor_copper_loss * torque**2
        return LiveState(
            time=self._ticks * TICK,
            x=x,
            y=y,
            z=z,
            quaternion=attitude,
            roll=float(roll_angle(attitude)),
            pitch=float(pitch_angle(attitude)),
            yaw=float(yaw_angle(attitude)),
            vx=velocity[0],
            vy=velocity[1],
            vz=velocity[2],
            roll_rate=rates[0],
            pitch_rate=rates[1],
            yaw_rate=rates[2],
            specific_force=specific_force(velocity, rates, slopes, attitude, gravity),
            wheel_speeds=wheel_speeds,
            drive_speed=drive_speed,
            drive_angle=self._drive_angle,
            steering_motor_angle=float(self._servo[0]),
            steering_motor_rate=float(self._servo[1]),
            loads=tuple(values[of_wheels(EVALUATED.load, WHEEL_EVALUATED, wheels)].tolist()),
            motor_torque=torque,
            motor_power=power,
            motor_current=power / self.vehicle.battery_voltage,
            rolled_over=bool(values[ALIVE] == 0.0),
        )
