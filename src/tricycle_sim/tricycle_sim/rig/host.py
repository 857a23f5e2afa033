"""A rig driven through the bridge's own logic, tick by tick, without ports and nodes."""

import random
from collections.abc import Iterator

from tricycle_bridge.bridge import Bridge
from tricycle_bridge.commands.command_stream import Source, VehicleCommand
from tricycle_bridge.measurements.joint_pairing import JointReadings
from tricycle_bridge.protocol.messages import Board
from tricycle_bridge.settings import BridgeSettings
from tricycle_core.errors import LinkError
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands
from tricycle_sim.rig.rig import Rig
from tricycle_sim.setpoints import command_rows

_OFFSET = 100.0  # s that the bridge's clock is ahead of the rig's


class Host:
    """The bridge, and a commander that sends a command every tick.

    Parameters
    ----------
    rig : Rig
        Vehicle and boards.
    settings : BridgeSettings
        Settings of the bridge.

    Attributes
    ----------
    bridge : Bridge
        The two links.
    target : VehicleCommand or None
        Command that the commander sends at every tick; None: nothing.
    odometry : bool
        Whether the bridge receives the vehicle's true speed as odometry, at 20 Hz.
    imu : bool
        Whether it receives the true specific force, at 100 Hz.
    readings : list of JointReadings
        The joints measured in the newest tick.
    log : list of str
        Messages that the bridge has logged.
    """

    def __init__(self, rig: Rig, settings: BridgeSettings | None = None) -> None:
        self.rig = rig
        rng = random.Random(0)  # noqa: S311 - sessions and nonces, the same in every run
        self.bridge = Bridge(settings or BridgeSettings(), rng=rng, simulated=True)
        self.bridge.active = True
        self.target: VehicleCommand | None = VehicleCommand(0.0, 0.0)
        self.odometry = self.imu = True
        self.readings: list[JointReadings] = []
        self.log: list[str] = []
        self._killed = False
        self._stamped = rig.host_time  # when the commander made its newest command
        self._open: set[Board] = set()
        self._watch_cables()

    @property
    def now(self) -> float:
        """Time on the bridge's clock [s], which nobody sets."""
        return _OFFSET + self.rig.time

    def tick(self) -> None:
        """Command, exchange bytes, and let the rig run for 10 ms."""
        if self._killed:
            self.rig.step()
            return
        self.send()
        for board, data in self.rig.step().items():
            self._hear(board, data)
        self.readings = self.bridge.take_readings()
        self.log += [entry.text for entry in self.bridge.take_log()]

    def send(self) -> None:
        """Command, and hand the boards what the bridge has to say."""
        bridge, now = self.bridge, self.now
        self._watch_cables()
        if self.target is not None:
            # it was made a tick ago; its age is taken on the clock that may have been set since
            stamp = now - (self.rig.host_time - self._stamped)
            bridge.set_command(self.target, stamp=stamp, now=now, source=Source.JOINT_COMMANDS)
        self._stamped = self.rig.host_time
        if self.odometry and round(self.rig.time / TICK) % 5 == 0:
            bridge.set_odometry(self.rig.state.vx, now)
        if self.imu:
            bridge.set_force(self.rig.state.specific_force[0], now)
        bridge.poll(now)
        for board, frames in bridge.take_frames().items():
            if frames:
                self._hear(board, self.rig.receive(board, b"".join(frames)))

    def run(self, seconds: float) -> None:
        """Run ticks for some time.

        Parameters
        ----------
        seconds : float
            Duration [s].
        """
        for _ in range(round(100 * seconds)):
            self.tick()

    def play(self, commands: Commands) -> Iterator[None]:
        """Drive commands with boards that are armed; yield after each tick.

        Parameters
        ----------
        commands : Commands
            Each held until the next.

        Raises
        ------
        LinkError
            If the boards stop; the message has the bridge's last words.
        """
        for row in command_rows(commands):
            angle, speed = commands.steering_motor_angle[row], commands.speed[row]
            self.target = VehicleCommand(float(angle), float(speed))
            self.tick()
            if not self.rig.armed:
                raise LinkError(f"the boards stopped: {'; '.join(self.log[-3:])}")
            yield

    def arm(self) -> None:
        """Stream standstill and arm both boards.

        Raises
        ------
        LinkError
            If the boards do not arm; the message has the bridge's reason.
        """
        outcomes: list[str] = []
        self.target = VehicleCommand(0.0, 0.0)
        self.run(0.3)
        self.bridge.arm(self.now, lambda outcome: outcomes.append(outcome.text))
        for _ in range(300):
            self.tick()
            if outcomes:
                break
        self.run(0.05)
        if not self.rig.armed:
            raise LinkError(f"not armed: {outcomes[0] if outcomes else 'no answer'}")

    def kill(self) -> None:
        """End the host as kill -9 does: from now on the rig is alone."""
        self._killed = True

    def _watch_cables(self) -> None:
        for board in self.bridge.links:
            if self.rig.plugged(board) and board not in self._open:
                self._open.add(board)
                self.bridge.opened(board, self.now)
            elif not self.rig.plugged(board) and board in self._open:
                self._open.discard(board)
                self.bridge.closed(board, "the cable is pulled")

    def _hear(self, board: Board, data: bytes) -> None:
        if data:
            self.bridge.receive(board, data, self.now)
