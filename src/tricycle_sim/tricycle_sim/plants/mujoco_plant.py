"""The vehicle as rigid bodies with hinges and frictional contacts, in MuJoCo.

Masses, inertia, places, caster and the tyres' springs are the vehicle file's. Where the
file says nothing: a wheel is a ring with its inertia, the tyre is thin. It slips by another law
than ours: in proportion to the force whatever the speed, a wheel with the cornering stiffness C at
C N per m/s, up to its friction. There is no relaxation, no camber force, no self-aligning moment
and no drag.
"""

import math
from typing import Any

import numpy as np

from tricycle_core.errors import PlantError
from tricycle_core.optional import missing
from tricycle_core.poses import Pose
from tricycle_core.quantities import FloatArray
from tricycle_core.rotations import pitch_angle, roll_angle, yaw_angle
from tricycle_core.timing import TICK
from tricycle_sim.plants.actuators import Motor, SteeringServo
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.body import upward
from tricycle_sim.vehicle.live import LiveState
from tricycle_sim.vehicle.parts import structure_of
from tricycle_sim.vehicle.registry import PARTS, law_name

try:
    import mujoco
except ModuleNotFoundError as error:
    raise PlantError(missing("mujoco", "the plant mujoco")) from error

SUBSTEPS = 10
"""Steps per tick."""
SETTLING = 2.0  # s on the tyres before a drive
KING_PIN_RATE = 300.0  # rad/s, of the stiff hold of a wheel's angle about its king-pin
# MuJoCo's contacts have a part of what touches for their own mass, the more the larger the ratio
# below: so little of it (0.04 kg) that the tyre is a spring, and adds nothing to the vehicle.
IMPEDANCE = 0.0002
# Ratio of the impedances of friction and of weight. Large: what slides keeps its weight. Below 1 a
# wheel at its friction limit is thrown off the ground.
FRICTION_RATIO = 10.0
LOOK = (  # squares of 1 m
    '<visual><global offwidth="1920" offheight="1080"/></visual><asset>'
    '<texture name="road" type="2d" builtin="checker" rgb1=".9 .9 .9" rgb2=".82 .82 .82" '
    'width="64" height="64"/>'
    '<material name="road" texture="road" texrepeat="0.5 0.5" texuniform="true"/></asset>'
)


class MujocoPlant:
    """The vehicle in MuJoCo.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle with its true values.
    seed : int
        Not used: nothing is random.

    Raises
    ------
    PlantError
        If the wheels' inertia leaves none for the body.
    """

    def __init__(self, vehicle: Vehicle, seed: int = 0) -> None:  # noqa: ARG002 (of every plant)
        self._vehicle = vehicle
        self._sides = structure_of(vehicle).sides[: len(vehicle.wheels)]
        each = [vehicle.of(wheel) for wheel in vehicle.wheels]
        law = law_name("drive", vehicle.wheels, vehicle.parts)
        drive = PARTS["drive"][law].rows["torque_share"]
        self._shares = np.array(
            [float(drive(o)) * w.driven for w, o in zip(vehicle.wheels, each, strict=True)]
        )
        self._brakes = np.array(
            [
                o.brake_torque / o.braked_wheels if w.braked else 0.0
                for w, o in zip(vehicle.wheels, each, strict=True)
            ]
        )
        self._rolling = np.array(
            [
                o.rolling_coefficient_1 * load * o.tyre_radius
                for o, load in zip(each, vehicle.static_loads(), strict=True)
            ]
        )
        self._model: Any = mujoco.MjModel.from_xml_string(_xml(vehicle))
        self._data: Any = mujoco.MjData(self._model)
        joints = [self._model.joint(f"{wheel.name}_spin") for wheel in vehicle.wheels]
        self._spins = np.array([joint.dofadr[0] for joint in joints])
        self._turns = np.array([joint.qposadr[0] for joint in joints])
        _give_inertia(self._model, self._data, _body_inertia(vehicle))
        self.place((0.0, 0.0, 0.0))
        self._soften()

    @property
    def scene(self) -> tuple[Any, Any]:
        """Model and data of MuJoCo, to be looked at."""
        return self._model, self._data

    def place(self, start: Pose) -> LiveState:
        """Return the state at rest at a pose, on settled tyres.

        Parameters
        ----------
        start : (float, float, float)
            x, y [m] and heading [rad].
        """
        x, y, heading = start
        data = self._data
        mujoco.mj_resetData(self._model, data)
        q = data.qpos
        q[2] = self._vehicle.com_height
        q[3:7] = math.cos(0.5 * heading), 0.0, 0.0, math.sin(0.5 * heading)
        self._servo, self._motor = SteeringServo(self._vehicle), Motor(self._vehicle)
        self._held = np.zeros(sum(side >= 0 for side in self._sides))  # angles about the king-pins
        self._over = False
        for _ in range(round(SETTLING / TICK)):
            self._run(brake=1.0)
        q[:2] = x, y
        data.qvel[:] = 0.0
        self._turned = self._shares @ q[self._turns]
        return self._state(0)

    def advance(self, tick: int, steering: float | None, torque: float, brake: float) -> LiveState:
        """Return the state after a tick.

        Parameters
        ----------
        tick, steering, torque, brake : int, float or None, float, float
            Arguments of `Plant.advance`.
        """
        if not self._over:
            self._servo.advance(steering)
            self._motor.advance(torque, self._shares @ self._data.qvel[self._spins])
            self._run(brake)
        state = self._state(tick + 1)
        if not state.rolled_over:
            return state
        self._motor.torque = 0.0  # it lies where it is from now on
        self._data.qvel[:] = 0.0
        self._data.ctrl[len(self._held) :] = 0.0
        mujoco.mj_forward(self._model, self._data)
        return self._state(tick + 1)

    def close(self) -> None:
        """Do nothing."""

    def _run(self, brake: float) -> None:
        """Simulate a tick with the servo's and the motor's state at its end."""
        model, data = self._model, self._data
        angles = self._servo.wheels
        wanted = np.array([angles[side] for side in self._sides if side >= 0])
        before, self._held = self._held, wanted
        lead = 2.0 / KING_PIN_RATE * (wanted - before) / TICK  # what its damping holds back
        data.ctrl[len(wanted) :] = self._motor.torque * self._shares
        model.dof_frictionloss[self._spins] = self._rolling + brake * self._brakes
        for step in range(1, SUBSTEPS + 1):
            data.ctrl[: len(wanted)] = before + (wanted - before) * step / SUBSTEPS + lead
            mujoco.mj_step(model, data)

    def _soften(self) -> None:
        """Give the settled tyres their springs, and let them slip by so much speed per force."""
        for contact in self._data.contact:
            pair = np.flatnonzero(self._model.pair_geom2 == contact.geom[1])[0]
            own = self._vehicle.of(self._vehicle.wheels[pair])
            normal, slip = IMPEDANCE / self._data.efc_D[contact.efc_address :][:2]
            spring = own.vertical_stiffness, own.vertical_damping
            self._model.pair_solref[pair] = -normal * np.array(spring)
            self._model.pair_solreffriction[pair] = 0.0, -slip * own.cornering_stiffness

    def _state(self, tick: int) -> LiveState:
        data, vehicle = self._data, self._vehicle
        quaternion = tuple(data.qpos[3:7].tolist())
        rotation = np.empty(9)
        mujoco.mju_quat2Mat(rotation, data.qpos[3:7])
        u, v, w = (rotation.reshape(3, 3).T @ data.qvel[:3]).tolist()
        p, q, r = data.qvel[3:6].tolist()
        self._over |= rotation[8] < math.cos(vehicle.rollover_angle)
        spins = data.qvel[self._spins]
        speed = float(self._shares @ spins)
        torque = self._motor.torque
        power = torque * speed + vehicle.motor_copper_loss * torque**2
        motor_angle, motor_rate = self._servo.motor
        x, y, z = data.qpos[:3].tolist()
        return LiveState(
            time=tick * TICK,
            x=x,
            y=y,
            z=z,
            quaternion=quaternion,
            roll=float(roll_angle(quaternion)),
            pitch=float(pitch_angle(quaternion)),
            yaw=float(yaw_angle(quaternion)),
            vx=u,
            vy=v,
            vz=w,
            roll_rate=p,
            pitch_rate=q,
            yaw_rate=r,
            specific_force=tuple(data.sensordata[:3].tolist()),
            wheel_speeds=tuple(spins.tolist()),
            drive_speed=speed,
            drive_angle=float(self._shares @ data.qpos[self._turns] - self._turned),
            steering_motor_angle=motor_angle,
            steering_motor_rate=motor_rate,
            loads=self._loads(),
            motor_torque=torque,
            motor_power=power,
            motor_current=power / vehicle.battery_voltage,
            rolled_over=bool(self._over),
        )

    def _loads(self) -> tuple[float, ...]:
        loads, force = np.zeros(len(self._vehicle.wheels)), np.zeros(6)
        for index, contact in enumerate(self._data.contact):
            mujoco.mj_contactForce(self._model, self._data, index, force)
            loads[self._model.pair_geom2 == contact.geom[1]] += force[0]
        return tuple(loads.tolist())


def _wheel_mass(own: Any) -> float:
    """Return the mass of a ring with the wheel's inertia [kg]."""
    return float(own.wheel_inertia / own.tyre_radius**2)


def _wheel_place(own: Any) -> FloatArray:
    return np.array([own.x, own.y, own.tyre_radius - own.com_height])


def _body_centre(vehicle: Vehicle) -> tuple[float, FloatArray]:
    """Return the mass of the body without its wheels [kg], and where its centre is [m]."""
    each = [vehicle.of(wheel) for wheel in vehicle.wheels]
    mass = vehicle.mass - sum(map(_wheel_mass, each))
    if mass <= 0.0:
        raise PlantError(f"{vehicle.name}: rings with the inertia of its wheels outweigh the mass")
    moment = np.sum([_wheel_mass(own) * _wheel_place(own) for own in each], axis=0)
    return mass, -moment / mass


def _body_inertia(vehicle: Vehicle) -> FloatArray:
    """Return the inertia of the body without its wheels about its own centre, (3, 3)."""
    mass, centre = _body_centre(vehicle)
    inertia = np.diag([vehicle.roll_inertia, vehicle.pitch_inertia, vehicle.yaw_inertia])
    inertia -= _displaced(mass, centre)
    for wheel in vehicle.wheels:
        own = vehicle.of(wheel)
        inertia -= _displaced(_wheel_mass(own), _wheel_place(own))
        inertia -= np.diag([0.5, 0.0, 0.5]) * own.wheel_inertia  # the file leaves the spin's out
    if np.linalg.eigvalsh(inertia)[0] <= 0.0:
        raise PlantError(f"{vehicle.name}: its wheels' inertia leaves none for the body")
    return inertia


def _displaced(mass: float, place: FloatArray) -> FloatArray:
    """Return the inertia of a point."""
    return mass * (float(place @ place) * np.eye(3) - np.outer(place, place))


def _give_inertia(model: Any, data: Any, inertia: FloatArray) -> None:
    """Set the body's inertia, also one that no rigid body has: the file's ranges hold such."""
    moments, axes = np.linalg.eigh(inertia)
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    body = model.body("body").id
    model.body_inertia[body] = moments
    mujoco.mju_mat2Quat(model.body_iquat[body], axes.ravel())
    mujoco.mj_setConst(model, data)


def _xml(vehicle: Vehicle) -> str:
    """Return the model of MuJoCo; the body's inertia is a stand-in."""
    mass, centre = _body_centre(vehicle)
    up = np.array([float(part) for part in upward(vehicle)])
    caster = vehicle.caster_angle
    king_pin = f"{-math.sin(caster)} 0 {math.cos(caster)}"
    bodies, seen, pairs, holds, motors = [], [], [], [], []
    for wheel, load in zip(vehicle.wheels, vehicle.static_loads(), strict=True):
        own, name = vehicle.of(wheel), wheel.name
        sinks, inertia = load / own.vertical_stiffness, own.wheel_inertia
        radius = own.tyre_radius - sinks  # on which it rolls; the spring begins so far outside
        steer = ""
        if wheel.steered:
            steer = f'<joint name="{name}_steer" axis="{king_pin}"/>'
            about = inertia * (0.5 + 0.5 * math.sin(caster) ** 2)  # at most, of the ring
            holds.append(
                f'<position joint="{name}_steer" kp="{about * KING_PIN_RATE**2}" '
                f'kv="{2.0 * about * KING_PIN_RATE}"/>'
            )
        motors.append(f'<motor joint="{name}_spin"/>')
        bodies.append(
            f'<body name="{name}" pos="{_row(_wheel_place(own))}">'
            f'<inertial pos="0 0 0" mass="{_wheel_mass(own)}" '
            f'diaginertia="{0.5 * inertia} {inertia} {0.5 * inertia}"/>'
            f'{steer}<joint name="{name}_spin" axis="0 1 0"/>'
            f'<geom name="{name}" type="ellipsoid" size="{radius} {0.06 * radius} {radius}" '
            'rgba=".12 .12 .13 1"/>'
            f'<geom type="box" size="{0.9 * radius} {0.07 * radius} {0.06 * radius}" '
            'rgba=".8 .8 .8 1"/></body>'
        )
        seen.append(
            f'<geom type="capsule" size=".03" fromto="0 0 0 {_row(_wheel_place(own))}" '
            'rgba=".35 .4 .45 1"/>'
        )
        friction = own.friction_coefficient
        pairs.append(
            f'<pair geom1="road" geom2="{name}" condim="3" '
            f'friction="{friction} {friction} 0 0 0" margin="{sinks}" '
            f'solimp="{IMPEDANCE} {IMPEDANCE} 1"/>'
        )
    return (
        f'<mujoco><option timestep="{TICK / SUBSTEPS}" integrator="implicitfast" '
        f'cone="elliptic" impratio="{FRICTION_RATIO}" gravity="{_row(-vehicle.gravity * up)}"/>'
        '<default><geom contype="0" conaffinity="0"/></default>'
        f'{LOOK}<worldbody><light directional="true" pos="0 0 9" dir=".3 .4 -1"/>'
        '<geom name="road" type="plane" size="100 100 1" material="road"/>'
        '<body name="body"><freejoint/><site name="com" rgba="0 0 0 0"/>'
        f'<inertial pos="{_row(centre)}" mass="{mass}" diaginertia="1 1 1"/>'
        f'<geom type="ellipsoid" size="{0.3 * vehicle.wheelbase} .2 .15" rgba=".84 .37 .18 1"/>'
        f"{''.join(seen)}{''.join(bodies)}</body></worldbody>"
        f"<contact>{''.join(pairs)}</contact>"
        f"<actuator>{''.join(holds)}{''.join(motors)}</actuator>"
        '<sensor><accelerometer site="com"/></sensor></mujoco>'
    )


def _row(values: FloatArray) -> str:
    return " ".join(map(repr, values.tolist()))
