"""The vehicle on a stand, with hands that do what `tricycle plc check` asks for.

Both boards run the firmware on simulated UNOs in real time. Servo, motor and brake are those of the
vehicle file. The driven wheel stands on rollers as heavy to turn as the vehicle: lifted, it turns
so easily that the drive board's wheel check (PULSES) takes it for a faulty sensor.
"""

import math
import threading
import time
from collections.abc import Callable
from pathlib import Path

from tricycle_bridge.commissioning.bring_up import TURNS
from tricycle_bridge.protocol.messages import Board
from tricycle_bringup.configuration import bridge_settings
from tricycle_core.timing import TICK
from tricycle_sim.plants.actuators import Motor, SteeringServo
from tricycle_sim.plants.plant import PlanarMotion, planar_state
from tricycle_sim.plc.pty_port import PtyPort
from tricycle_sim.rig.faults import FaultKind
from tricycle_sim.rig.firmware import FirmwareRig
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.live import LiveState

BY_HAND = math.tau  # rad/s of a wheel that a hand turns
PULL = 15.0  # N m of a hand that tries the brake: 45 N at the tyre
BEARING = 0.5  # N m, of wheel and rollers
END = 0.775  # rad: where a hand leaves the steering, at its end stop
POLL = 0.001  # s
STANDING = PlanarMotion(0.0, 0.0, 0.0, 0.0, 0.0)


class VehicleOnRollers:
    """A plant on a stand, and the hands at it.

    Attributes
    ----------
    held : float or None
        Steering angle [rad] to which a hand turns the gear, where the servo has no pulses.
    turns : float
        Turns of the driven wheel that a hand has still to make, against the brake if it must.
    pull : float
        Torque of a hand on the driven wheel [N m].
    """

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self._inertia = bridge_settings(vehicle).mass * vehicle.driven_radius**2
        self.held: float | None = None
        self.turns = self.pull = 0.0

    def place(self, _: object) -> LiveState:
        self._servo, self._motor = SteeringServo(self._vehicle), Motor(self._vehicle)
        self._angle = self._spin = 0.0
        return self._state(0)

    def advance(self, tick: int, steering: float | None, torque: float, brake: float) -> LiveState:
        self._servo.advance(self.held if steering is None else steering)
        self._motor.advance(torque, self._spin)
        if self.turns > 0.0:
            turned = min(self.turns, TICK * BY_HAND / math.tau)
            self.turns -= turned
            self._spin = math.tau * turned / TICK if self.turns > 1e-9 else 0.0
        else:
            push = TICK * (self._motor.torque + self.pull) / self._inertia
            friction = TICK * (BEARING + brake * self._vehicle.brake_torque) / self._inertia
            free = self._spin + push
            self._spin = math.copysign(max(0.0, abs(free) - friction), free)
        self._angle += TICK * self._spin
        return self._state(tick + 1)

    def _state(self, tick: int) -> LiveState:
        return planar_state(
            self._vehicle,
            tick,
            (0.0, 0.0, 0.0),
            STANDING,
            steering=self._servo.motor,
            wheel=(self._angle, self._spin),
            torque=self._motor.torque,
        )

    def close(self) -> None:
        pass


class Stand:
    """The boards of a vehicle on rollers, on serial devices, and an engineer who does as told."""

    def __init__(self, vehicle: Vehicle, firmware: Path, paths: dict[Board, Path]) -> None:
        self._plant = VehicleOnRollers(vehicle)
        self._rig = FirmwareRig(vehicle, firmware, plant=self._plant)
        self._ports = {board: PtyPort(path) for board, path in paths.items()}
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="stand")

    def __enter__(self) -> "Stand":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join()
        self._rig.close()
        for port in self._ports.values():
            port.close()

    def do(self, request: str) -> None:
        """Do what a line of `plc check` asks for."""
        deeds: dict[str, Callable[[], None]] = {
            "Press the": lambda: self._rig.fail({FaultKind.ESTOP}),
            "Release the": lambda: self._rig.fail(()),
            "left end stop": lambda: self._hold(END),
            "right end stop": lambda: self._hold(-END),
            "Unplug the hall": lambda: self._rig.fail({FaultKind.HALL_OPEN}),
            "Plug the hall": lambda: self._rig.fail(()),
            "Turn the driven": self._turn,
            "Try to turn": lambda: self._pull(PULL),
            "Pull the drive": lambda: self._rig.fail({FaultKind.DRIVE_CABLE}),
            "Put the cable": lambda: self._rig.fail(()),
        }
        self._pull(0.0)
        for words, deed in deeds.items():
            if words in request:
                deed()

    def _hold(self, angle: float) -> None:
        self._plant.held = angle

    def _turn(self) -> None:
        self._plant.held = None
        self._plant.turns = TURNS

    def _pull(self, torque: float) -> None:
        self._plant.pull = torque

    def _run(self) -> None:
        """Serve the boards, 100 ticks per second."""
        due = time.monotonic()
        while not self._ending.is_set():
            due = max(due + TICK, time.monotonic() - TICK)
            while time.monotonic() < due:
                for board, port in self._ports.items():
                    if data := port.read():
                        port.write(self._rig.receive(board, data))
                time.sleep(POLL)
            for board, data in self._rig.step().items():
                self._ports[board].write(data)
            for board, port in self._ports.items():
                if port.plugged and not self._rig.plugged(board):
                    port.unplug()
                elif self._rig.plugged(board) and not port.plugged:
                    port.plug()
