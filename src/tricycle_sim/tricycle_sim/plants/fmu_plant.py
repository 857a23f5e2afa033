"""An FMU as a plant: `plant:=fmu:mapping.yaml`.

What its mapping lacks follows from the rest: velocities and accelerations from the poses, the
driven wheels' speed from the forward velocity and their angle from that, the steering motor from
the vehicle file's servo.
"""

import contextlib
import math
from pathlib import Path

from tricycle_core.errors import PlantError
from tricycle_core.poses import Pose
from tricycle_core.timing import TICK
from tricycle_sim.fmi.cosimulation import Fmu, Instance
from tricycle_sim.fmi.mapping import START, FmuMapping, load_mapping
from tricycle_sim.plants.actuators import SteeringServo
from tricycle_sim.plants.plant import PlanarMotion, planar_state
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.live import LiveState


def fmu_plant(
    vehicle: Vehicle,
    seed: int = 0,  # noqa: ARG001
    file: Path | None = None,
) -> "FmuPlant":
    """Return an FMU as a plant.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle as boards and planner know it; its values are those of the mapping's parameters.
    seed : int
        Not used: nothing is random.
    file : Path
        Path of the mapping file.

    Raises
    ------
    PlantError
        If there is no mapping, or the FMU does not fit it.
    """
    if file is None:
        raise PlantError("the plant fmu needs its mapping file: fmu:FILE.yaml")
    mapping = load_mapping(file)
    kind = SpeedFmuPlant if "speed" in mapping.inputs else FmuPlant
    return kind(vehicle, mapping, file)


class FmuPlant:
    """An FMU that takes a torque.

    Parameters
    ----------
    vehicle : Vehicle
        Vehicle as boards and planner know it; its values are those of the mapping's parameters.
    mapping : FmuMapping
        Mapping of our quantities to the FMU's variables.
    file : Path
        Path of the mapping file, for messages.

    Raises
    ------
    PlantError
        If the FMU does not fit the mapping, or the mapping lacks what a plant needs.
    """

    def __init__(self, vehicle: Vehicle, mapping: FmuMapping, file: Path) -> None:
        self._vehicle = vehicle
        self._has_torque = "torque" in mapping.inputs
        self._has_brake = "brake" in mapping.inputs
        if not self._has_torque and "speed" not in mapping.inputs:
            raise PlantError(f"{file}: inputs: a plant needs torque or speed")
        if {"torque", "speed"} <= set(mapping.inputs) and "torque_mode" not in mapping.inputs:
            # the FMU could not tell which of them counts: a stop, by torque and brake, may be lost
            raise PlantError(f"{file}: inputs: speed and torque together need torque_mode")
        self._steps = mapping.steps_per_tick(file, "a plant", ("steering",))
        self._parameters = [name for name in mapping.parameters if name not in START]
        for name in self._parameters:
            if name not in vehicle.values:
                raise PlantError(f"{file}: parameters.{name}: {vehicle.name} has no such constant")
        units = {name: vehicle.unit(name) for name in self._parameters}
        self._own_servo = "steering_motor_angle" not in mapping.outputs
        with contextlib.ExitStack() as failing:
            self._fmu = Fmu(mapping, units)
            failing.callback(self._fmu.close)
            self._instance = self._begin()
            failing.callback(self.close)
            self.place((0.0, 0.0, 0.0))
            failing.pop_all()

    def place(self, start: Pose) -> LiveState:
        """Return the state at rest at a pose.

        Parameters
        ----------
        start : (float, float, float)
            x, y [m] and heading [rad].

        Raises
        ------
        PlantError
            If the FMU does not start anew; it then goes on from where it was, unless a process
            can have one instance of it only.
        """
        if self._fmu.only_once:
            self._instance.close()
        with contextlib.ExitStack() as failing:
            fresh = self._begin()
            failing.callback(fresh.close)
            outputs = fresh.read()
            failing.pop_all()
        self._instance.close()
        self._instance, self._outputs = fresh, outputs
        self._servo = SteeringServo(self._vehicle)
        self._turned = 0.0
        self._unturned = self._outputs.get("drive_angle", 0.0)
        self._origin, self._start = self._pose(), start
        self._motion = PlanarMotion(*(self._outputs.get(n, 0.0) for n in PlanarMotion._fields))
        self._spin = 0.0
        return self._state(0)

    def advance(self, tick: int, steering: float | None, torque: float, brake: float) -> LiveState:
        """Return the state after a tick.

        Parameters
        ----------
        tick, steering, torque, brake : int, float or None, float, float
            Arguments of `Plant.advance`.
        """
        if self._has_torque:
            return self._moved(tick, steering, brake, torque=torque, torque_mode=1.0)
        # an FMU that only takes a speed gets the one that the torque makes of the vehicle's mass
        per_torque = TICK / self._vehicle.driven_radius / self._vehicle.mass
        speed = self._tread_speed() + per_torque * torque
        if not self._has_brake:
            held = per_torque * brake * self._vehicle.brake_torque
            speed -= math.copysign(min(held, abs(speed)), speed)
        return self._moved(tick, steering, brake, speed=speed)

    def close(self) -> None:
        """End the FMU and remove what was unpacked; a second call does nothing."""
        self._instance.close()
        self._fmu.close()

    def _begin(self) -> Instance:
        return self._fmu.start({name: self._vehicle.values[name] for name in self._parameters})

    def _tread_speed(self) -> float:
        return self._spin * self._vehicle.driven_radius

    def _pose(self) -> Pose:
        return self._outputs["x"], self._outputs["y"], self._outputs["heading"]

    def _moved(self, tick: int, steering: float | None, brake: float, **inputs: float) -> LiveState:
        if self._own_servo:
            self._servo.advance(steering)
            angle = self._servo.output
        else:  # without pulses the gear holds the angle that there is
            angle = self._outputs["steering_motor_angle"] if steering is None else steering
        before = self._pose()
        self._instance.set(steering=angle, brake=brake, **inputs)
        for _ in range(self._steps):
            self._instance.advance()
        self._outputs = self._instance.read()
        self._motion = self._moving(before)
        spin = self._outputs.get("drive_speed")
        if spin is None:
            spin = self._motion.vx / self._vehicle.driven_radius
        turned = self._unturned + self._turned + 0.5 * TICK * (self._spin + spin)
        self._turned = self._outputs.get("drive_angle", turned) - self._unturned
        self._spin = spin
        return self._state(tick + 1)

    def _moving(self, before: Pose) -> PlanarMotion:
        """Return velocities and accelerations: the FMU's outputs, or else by the last tick."""
        found, old = self._outputs, self._motion
        x, y, heading = self._pose()
        turned = math.remainder(heading - before[2], math.tau)
        middle = before[2] + 0.5 * turned
        dx, dy = (x - before[0]) / TICK, (y - before[1]) / TICK
        vx = found.get("vx", dx * math.cos(middle) + dy * math.sin(middle))
        vy = found.get("vy", dy * math.cos(middle) - dx * math.sin(middle))
        yaw_rate = found.get("yaw_rate", turned / TICK)
        ax = found.get("ax", (vx - old.vx) / TICK - yaw_rate * vy)
        ay = found.get("ay", (vy - old.vy) / TICK + yaw_rate * vx)
        return PlanarMotion(vx, vy, yaw_rate, ax, ay)

    def _state(self, tick: int) -> LiveState:
        found, (x0, y0, heading0), (x, y, heading) = self._outputs, self._origin, self._pose()
        turn = self._start[2] - heading0
        c, s = math.cos(turn), math.sin(turn)
        dx, dy = x - x0, y - y0
        pose = self._start[0] + c * dx - s * dy, self._start[1] + s * dx + c * dy, heading + turn
        angle, rate = self._servo.motor
        if not self._own_servo:
            angle, rate = found["steering_motor_angle"], found.get("steering_motor_rate", 0.0)
        return planar_state(
            self._vehicle,
            tick,
            pose,
            self._motion,
            steering=(angle, rate),
            wheel=(self._turned, self._spin),
            torque=found.get("motor_torque", 0.0),
        )


class SpeedFmuPlant(FmuPlant):
    """An FMU that takes a set-point of the speed, which its own controller holds."""

    def hold_speed(
        self, tick: int, steering: float | None, speed: float, brake: float
    ) -> LiveState:
        """Return the state after a tick with a set-point of the speed.

        Parameters
        ----------
        tick, steering, speed, brake : int, float or None, float, float
            Arguments of `HoldsSpeed.hold_speed`.
        """
        return self._moved(tick, steering, brake, speed=speed, torque_mode=0.0)
