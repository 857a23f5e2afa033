"""The bridge between vehicle commands in SI units and two by-wire links; no port, no ROS inside.

`Bridge` forwards commands, arms and stops both boards, and stops one board when the other is lost.
Times are seconds on one clock of the owner, which is never set while the bridge is used.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from typing import NamedTuple

from tricycle_bridge.arming import (
    ArmingOutcome,
    ArmingSequence,
    arming_refusal,
    board_condition,
    fresh_state,
    measured_speed,
    waiting_speed,
)
from tricycle_bridge.commands.board_commands import (
    board_setup,
    drive_command,
    steer_command,
    stop_command,
)
from tricycle_bridge.commands.command_messages import limit_refusal
from tricycle_bridge.commands.command_stream import (
    JITTER,
    Commander,
    CommandStream,
    Source,
    VehicleCommand,
)
from tricycle_bridge.measurements.joint_pairing import JointPairing, JointReadings, joint_reading
from tricycle_bridge.measurements.odometry_watch import OdometryWatch
from tricycle_bridge.measurements.start_watch import StartWatch
from tricycle_bridge.plc_link.link import LinkEvent, LinkEventKind, LinkState, PlcLink
from tricycle_bridge.plc_link.operations import OperationOutcome
from tricycle_bridge.protocol.boards import AT_REST
from tricycle_bridge.protocol.limits import ARMING_SPEED
from tricycle_bridge.protocol.messages import (
    Board,
    CommandFlag,
    DriveState,
    Fault,
    Gear,
    Op,
    PlcState,
    Result,
    StateFlag,
    SteerState,
)
from tricycle_bridge.protocol.units import ANGLE_UNIT, SPEED_UNIT
from tricycle_bridge.settings import BridgeSettings
from tricycle_core.diagnostics import Level
from tricycle_core.readiness import Readiness
from tricycle_core.timing import TICK

BOARDS = (Board.STEER, Board.DRIVE)
# integers: joining members of an enumeration takes many times as long
_ENABLE, _ESTOP, _STANDSTILL = map(
    int, (CommandFlag.ENABLE, CommandFlag.ESTOP, CommandFlag.STANDSTILL)
)

DOUBTED = int(Fault.PULSES | Fault.HALL_LINE | Fault.OVERSPEED | Fault.STOP_TIMEOUT)
"""Faults with which a wheel speed of 0 may be a broken sensor's."""

LET_GO_AFTER = 0.3
"""Time at rest after which the steering may let go [s]: a board that was reset says 0 at first."""


class LogEntry(NamedTuple):
    """A line for the log.

    Attributes
    ----------
    level : Level
        WARN, or OK for information.
    text : str
        Text of the line.
    """

    level: Level
    text: str


class Bridge:
    """Two links driven as one vehicle.

    Feed it with `set_command`, `set_odometry`, `set_force`, `receive` and `poll`; write what
    `take_frames` returns, publish what `take_readings` returns, log what `take_log` returns.

    Parameters
    ----------
    settings : BridgeSettings
        Rates, and the vehicle that the boards are set up for. The attribute may be replaced at any
        time, for commands; what the boards are set up for stays.
    rng : random.Random
        Source of sessions and nonces.
    boot_wait : float
        Silence after opening a port [s].
    simulated : bool
        Whether the host's time is simulated.

    Attributes
    ----------
    links : dict of Board to PlcLink
        The two links.
    commands : CommandStream
        The commanders' messages.
    odometry : OdometryWatch
        Compares the wheel's speed with odometry.
    start : StartWatch
        Compares the wheel's first pulses with the IMU.
    bring_up_problem : callable
        Returns why the record of the bring-up does not allow to arm; None if it does, or if none is
        asked for.
    active : bool
        Whether commands are forwarded (lifecycle).
    stopped_by : str
        Why the vehicle was last stopped; empty since the last request to arm.
    """

    def __init__(
        self,
        settings: BridgeSettings,
        *,
        rng: random.Random,
        boot_wait: float = 0.0,
        simulated: bool = False,
    ) -> None:
        self.links = {
            board: PlcLink(
                board,
                rng=rng,
                boot_wait=boot_wait,
                setup=board_setup(board, settings),
                simulated=simulated,
            )
            for board in BOARDS
        }
        self.settings = settings
        self.commands = CommandStream()
        self.odometry = OdometryWatch()
        self.start = StartWatch(settings.hall_pulse)
        self.active = False
        self.bring_up_problem: Callable[[], str | None] = lambda: None
        self.stopped_by = ""
        self._enabled = False  # commands are sent with the enable flag
        self._estopped = False  # the operator's e-stop, until the next request to arm
        self._stop_sent_at = -math.inf
        self._rests_since: float | None = None  # the vehicle, as far as the wheel is trusted
        self._gear = Gear.DRIVE
        self._angle = 0.0  # rad, of the last command that was sent
        self._arming: ArmingSequence | None = None
        self._arming_done: Callable[[ArmingOutcome], None] = lambda _: None
        self._polled_at = -math.inf
        self._log: list[LogEntry] = []
        self._pairing = JointPairing()

    # ---- what the owner asks ----

    @property
    def wheel_problem(self) -> str | None:
        """Contradiction between the wheel's speed and odometry or the IMU; None without one."""
        return self.odometry.problem or self.start.problem

    @property
    def armed(self) -> bool:
        """Whether both boards were ARMED in their newest telemetry."""
        steer, drive = self.links.values()
        return steer.plc_state == drive.plc_state == PlcState.ARMED

    def take_log(self) -> list[LogEntry]:
        """Return what is to be logged since the last call."""
        log, self._log = self._log, []
        return log

    def take_readings(self) -> list[JointReadings]:
        """Return the joints measured since the last call."""
        return self._pairing.take()

    def take_frames(self) -> dict[Board, list[bytes]]:
        """Return the frames to write, by board."""
        return {board: link.take_frames() for board, link in self.links.items()}

    def refusal(self, now: float) -> str | None:
        """Return why the vehicle cannot be armed now; None if it can."""
        if not self.active:
            return "the bridge is not active"
        refusal = arming_refusal(self.links, self.commands.newest(now), now, enabled=self._enabled)
        return refusal or self.bring_up_problem()

    def readiness(self, now: float) -> Readiness:
        """Return whether the vehicle accepts commands, and whose, at a time [s]."""
        commander = self.commands.commander
        name = "" if commander is None else commander.name or commander.source.value
        if self.armed and self._enabled and self._arming is None:
            return Readiness(True, commander=name, refused=self.commands.refusal(now))
        reason = self.refusal(now) or "waiting for the operator"
        if self.stopped_by:
            reason += f"; stopped: {self.stopped_by}"
        return Readiness(False, reason, name)

    def resting_angle(self) -> float:
        """Return the steering angle for standstill [rad]: the measured one until it is armed."""
        telemetry = self.links[Board.STEER].telemetry
        if self._enabled or not isinstance(telemetry, SteerState):
            return self._angle
        largest = self.settings.max_steering_angle
        return min(max(telemetry.angle * ANGLE_UNIT, -largest), largest)

    # ---- what the owner does ----

    def opened(self, board: Board, now: float) -> None:
        """Begin the handshake on a port that was just opened.

        Parameters
        ----------
        board : Board
            Board expected behind the port.
        now : float
            Present time [s].
        """
        self.links[board].opened(now)

    def closed(self, board: Board, reason: str) -> None:
        """Note that a port is gone, or cannot be opened.

        Parameters
        ----------
        board : Board
            Board expected behind the port.
        reason : str
            Why, for a person; it is logged once.
        """
        link = self.links[board]
        told = link.up or link.problem == reason  # a loss is an event
        self._take_events(board, link.closed(reason))
        if not told:
            self._warn(f"{board.plc_name}: {reason}")

    def set_command(
        self,
        command: VehicleCommand | None,
        *,
        stamp: float,
        now: float,
        source: Source,
        name: str = "",
    ) -> str | None:
        """Take a commander's message and send it on when it is due.

        Parameters
        ----------
        command : VehicleCommand or None
            Command; beyond the vehicle's limits it counts as standstill. None: the boards are to
            stop the vehicle, until the operator's next ARM.
        stamp : float
            Time at which it was wanted [s].
        now : float
            Time of arrival [s].
        source : Source
            Topic on which it came.
        name : str
            Name that the commander gives itself.

        Returns
        -------
        refusal : str or None
            Why it is refused; None if it was taken.
        """
        if command is not None and (reason := limit_refusal(command, self.settings)) is not None:
            return self.refuse_command(reason, stamp=stamp, now=now, source=source, name=name)
        commander = Commander(source, name)
        wanted = command or VehicleCommand(self.resting_angle(), 0.0)
        refusal = self.commands.add(wanted, stamp=stamp, now=now, commander=commander)
        if refusal is None:
            if command is None:
                self._withdraw(f"by {commander}")
            # the boards are sent standstill until both are armed, and cannot see it
            if self._arming is not None and (reason := waiting_speed(self.commands.newest(now))):
                self._withdraw(reason)
            self._send_commands(now)
        return refusal

    def refuse_command(
        self, reason: str, *, stamp: float, now: float, source: Source, name: str = ""
    ) -> str:
        """Take a message that cannot be obeyed as the commander's wish to stand still.

        Parameters
        ----------
        reason : str
            Why the command is refused.
        stamp, now : float
            Time at which it was sent, time of arrival [s].
        source : Source
            Topic on which it came.
        name : str
            Name that the commander gives itself.

        Returns
        -------
        refusal : str
            Why it is refused, by whom it came.
        """
        commander = Commander(source, name)
        standstill = VehicleCommand(self.resting_angle(), 0.0)
        refusal = self.commands.refuse(
            standstill, reason, stamp=stamp, now=now, commander=commander
        )
        if refusal is not None:
            return refusal
        self._send_commands(now)
        return f"{commander} is refused: {reason}; the vehicle is to stand still"

    def set_odometry(self, speed: float, now: float) -> None:
        """Take a speed of odometry, to compare the wheel's with it.

        Parameters
        ----------
        speed : float
            Speed [m/s], forward positive.
        now : float
            Time of arrival [s].
        """
        self.odometry.add_odometry(speed, now)

    def set_force(self, force: float, now: float) -> None:
        """Take a specific force of an IMU, which the wheel's first pulses are compared with.

        Parameters
        ----------
        force : float
            Specific force, forward positive [m/s^2].
        now : float
            Time of arrival [s].
        """
        self.start.add_force(force, now)

    def receive(self, board: Board, data: bytes, now: float) -> None:
        """Take bytes from a port.

        Parameters
        ----------
        board : Board
            Board expected behind the port.
        data : bytes
            Received bytes; they may begin and end anywhere in a frame.
        now : float
            Time of arrival [s].
        """
        self._take_events(board, self.links[board].receive(data, now))

    def poll(self, now: float) -> None:
        """Do what is due; to be called after every `receive` and at least every 50 ms."""
        self._polled_at = now
        for board, link in self.links.items():
            self._take_events(board, link.poll(now))
        self._check_boards_agree()
        state = fresh_state(self.links[Board.DRIVE], now)
        self.odometry.compare(None if state is None else state.speed * SPEED_UNIT, now)
        self.start.look(state)
        self._look_for_rest(state, now)
        if self._enabled and (problem := self.wheel_problem) is not None:
            self._withdraw(problem)
        self._send_commands(now)
        self._send_stop(now)
        if self._arming is not None:
            self._arming.advance(now)
            self._finish_arming()

    def poll_is_due(self, now: float) -> bool:
        """Whether the last `poll` is a tick ago; without a `receive` an earlier one finds nothing.

        Parameters
        ----------
        now : float
            Present time [s].
        """
        return not 0.0 <= now - self._polled_at < TICK - JITTER

    def arm(self, now: float, done: Callable[[ArmingOutcome], None]) -> None:
        """Have both boards clear their faults and arm.

        Parameters
        ----------
        now : float
            Present time [s].
        done : callable
            Called once with the outcome, possibly before this returns.
        """
        if self._arming is not None:
            done(ArmingOutcome(False, "arming is under way"))
        elif self.armed and self._enabled:
            done(ArmingOutcome(True, "already armed"))
        elif (reason := self.refusal(now)) is not None:
            done(ArmingOutcome(False, f"not armed: {reason}"))
        else:
            self._angle = self.resting_angle()
            self.commands.begin(now)
            self._enabled = True
            self._estopped = False
            self.stopped_by = ""
            self._arming, self._arming_done = ArmingSequence(self.links, now), done

    def release(self, now: float) -> tuple[bool, str]:
        """Let another commander take over a vehicle that stands still.

        Parameters
        ----------
        now : float
            Present time [s].

        Returns
        -------
        done : bool
            Whether it was released.
        text : str
            Text for the operator.
        """
        commander = self.commands.commander
        if commander is None:
            return True, "nobody commands the vehicle"
        speed = measured_speed(self.links[Board.DRIVE], now)
        if speed is None or abs(speed) >= ARMING_SPEED:
            motion = "at an unknown speed" if speed is None else f"at {speed:.2f} m/s"
            return False, f"not released: the vehicle moves {motion} for {commander}"
        self.commands.release(now)
        return True, f"released by {commander}"

    def disarm(self, now: float) -> tuple[bool, str]:
        """Disarm both boards at once: outputs off, brake on.

        Parameters
        ----------
        now : float
            Present time [s].

        Returns
        -------
        done : bool
            Whether it was sent to both.
        text : str
            Text for the operator.
        """
        self._withdraw("disarmed by the operator")
        return self._operate_all(Op.DISARM, now)

    def emergency_stop(self, now: float) -> tuple[bool, str]:
        """Latch ESTOP on both boards until the next ARM; return what `disarm` returns.

        It is sent as an operation and in the flags of every command.

        Parameters
        ----------
        now : float
            Present time [s].
        """
        self._withdraw("emergency stop")
        self._estopped = True
        return self._operate_all(Op.ESTOP, now)

    def restart_links(self, now: float, reason: str) -> None:
        """Repeat the handshakes on the open ports, after the host's clock jumped back.

        Parameters
        ----------
        now : float
            Present time [s].
        reason : str
            Why, for a person.
        """
        self.commands.clear()
        self._pairing.clear()
        for board, link in self.links.items():
            if link.state is not LinkState.CLOSED:
                self.closed(board, reason)
                self.opened(board, now)

    def stop(self, reason: str) -> None:
        """Let both boards come to rest, without a fault, until the operator's next ARM."""
        self._withdraw(reason)

    # ---- commands ----

    def _send_commands(self, now: float) -> None:
        if not self.active:
            return
        command = self.commands.due(
            now,
            repeat_rate=self.settings.command_rate,
            standstill_rate=self.settings.standstill_rate,
            enabled=self._enabled,
            standstill=self._standstill,
        )
        if command is None:
            return
        if self._arming is not None:  # until both boards are armed, the vehicle stands
            command = VehicleCommand(self.resting_angle(), 0.0)
        flags = (_ENABLE if self._enabled else 0) | (_ESTOP if self._estopped else 0)
        steer = steer_command(command, self.settings, flags | self._standstill_flag(now))
        drive = drive_command(command, self.settings, flags, self._gear)
        self._angle, self._gear = command.steering_motor_angle, Gear(drive.gear)
        sent = [
            self.links[Board.STEER].send_command(steer),
            self.links[Board.DRIVE].send_command(drive),
        ]
        if self._arming is not None and all(sent):
            self._arming.count_command()

    def _standstill(self) -> VehicleCommand | None:
        """Return the command that is sent while no commander's command is fresh; None for none.

        Nothing where somebody has commanded the armed vehicle, so that the boards stop it; unless
        it has come to rest by the commander's last command already.
        """
        last = self.commands.last
        stopped = last is not None and last.speed == 0.0 and self._rests_since is not None
        if self._enabled and self.commands.commander is not None and not stopped:
            return None
        return VehicleCommand(self.resting_angle(), 0.0)

    def _look_for_rest(self, state: DriveState | None, now: float) -> None:
        rests = (
            state is not None
            and abs(state.speed * SPEED_UNIT) < AT_REST
            and not state.faults & DOUBTED
            and self.wheel_problem is None
        )
        if not rests:
            self._rests_since = None
        elif self._rests_since is None:
            self._rests_since = now

    def _standstill_flag(self, now: float) -> int:
        """STANDSTILL where the vehicle surely rests: the steering may let go then."""
        since = self._rests_since
        return _STANDSTILL if since is not None and now - since >= LET_GO_AFTER else 0

    def _send_stop(self, now: float) -> None:
        """While commands are not forwarded, command boards that are not at rest to stop."""
        if self.active or self._enabled:
            return
        if now - self._stop_sent_at < 1.0 / self.settings.command_rate - JITTER:
            return
        for link in self.links.values():
            telemetry = link.telemetry
            if telemetry is not None and (
                telemetry.state in (PlcState.ARMED, PlcState.STOPPING)
                or telemetry.flags & StateFlag.HOLDING
            ):
                link.send_command(stop_command(telemetry, self._standstill_flag(now)))
                self._stop_sent_at = now

    def _withdraw(self, reason: str) -> None:
        """Send no enabled command any more until the operator's next ARM."""
        if self._enabled:
            self._warn(f"stopped: {reason}")
            self.stopped_by = reason
        self._enabled = False
        self.commands.unlock()
        self._stop_sent_at = -math.inf
        self._end_arming(ArmingOutcome(False, f"not armed: {reason}"))

    def _operate_all(self, op: Op, now: float) -> tuple[bool, str]:
        unreached = [board.name.lower() for board, link in self.links.items() if not link.up]
        for link in self.links.values():
            link.operate(op, now)
        missing = f"; no link to the {' and '.join(unreached)} PLC" if unreached else ""
        return not unreached, f"{op.name} sent{missing}"

    # ---- arming ----

    def _finish_arming(self) -> None:
        if self._arming is None:
            return
        if self._arming.failure is not None:
            self._withdraw(self._arming.failure)
        elif self._arming.complete:
            self.commands.lock()
            self._end_arming(ArmingOutcome(True, "armed"))

    def _end_arming(self, outcome: ArmingOutcome) -> None:
        arming, self._arming = self._arming, None
        if arming is not None:
            for link in self.links.values():
                link.forget_operations()  # a lost ARM must not be sent again after the end
            self._arming_done(outcome)

    # ---- boards ----

    def _check_boards_agree(self) -> None:
        """Stop the other board when one that was armed no longer is."""
        if not self._enabled or self._arming is not None or self.armed:
            return
        for link in self.links.values():
            if link.plc_state != PlcState.ARMED:
                self._withdraw(board_condition(link))
                return

    def _take_events(self, board: Board, events: list[LinkEvent]) -> None:
        if not events:
            return
        for event in events:
            match event.kind:
                case LinkEventKind.TELEMETRY:
                    self._take_telemetry(board, event)
                case LinkEventKind.OPERATION:
                    if event.operation is not None:
                        self._take_outcome(board, event.operation)
                case LinkEventKind.UP | LinkEventKind.STATE_CHANGED:
                    self._log.append(LogEntry(Level.OK, event.text))
                case LinkEventKind.SILENT | LinkEventKind.REFUSED:
                    self._warn(f"{board.plc_name}: {event.text}")
                case LinkEventKind.SETUP_FAILED:
                    self._warn(event.text)
                case LinkEventKind.LOST | LinkEventKind.REBOOTED:
                    self._rests_since = None
                    self._warn(event.text)
                    self._withdraw(event.text)
        self._check_boards_agree()

    def _take_telemetry(self, board: Board, event: LinkEvent) -> None:
        if event.state is None:
            return
        settings = self.settings
        reading = joint_reading(
            event.state, self.links[board].limits, settings.tyre_radius, settings.hall_pulse
        )
        if reading is not None:
            partner = Board.DRIVE if board is Board.STEER else Board.STEER
            self._pairing.add(board, reading, event.stamp, partner_up=self.links[partner].up)

    def _take_outcome(self, board: Board, outcome: OperationOutcome) -> None:
        if self._arming is not None and outcome.op in (Op.CLEAR, Op.ARM):
            self._arming.take_outcome(board, outcome)
            self._finish_arming()
        elif outcome.result is None:
            self._warn(f"{board.plc_name} did not answer {outcome.op.name}")
        elif outcome.result is not Result.OK:
            self._warn(f"{board.plc_name} refused {outcome.op.name}: {outcome.result.name}")

    def _warn(self, text: str) -> None:
        self._log.append(LogEntry(Level.WARN, text))
