"""The bridge between vehicle commands in SI units and two by-wire links; no port, no ROS inside.

`Bridge` forwards commands, arms and stops both boards, and stops one board when the other is lost.
Times are seconds on the host's (ROS) clock.
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
)
from tricycle_bridge.board_commands import drive_command, steer_command, stop_command
from tricycle_bridge.command_stream import JITTER, CommandStream, Source, VehicleCommand
from tricycle_bridge.joint_pairing import JointPairing, JointReadings, joint_reading
from tricycle_bridge.link import LinkEvent, LinkEventKind, LinkState, PlcLink
from tricycle_bridge.operations import OperationOutcome
from tricycle_bridge.protocol.messages import Board, CommandFlag, Gear, Op, PlcState, Result
from tricycle_bridge.settings import BridgeSettings
from tricycle_core.diagnostics import Level

BOARDS = (Board.STEER, Board.DRIVE)


class LogEntry(NamedTuple):
    """A line for the log.

    Attributes
    ----------
    level : Level
        WARN, or OK for information.
    text : str
        The line.
    """

    level: Level
    text: str


class Bridge:
    """Two links driven as one vehicle.

    Feed it with `set_command`, `receive` and `poll`; write what `take_frames` returns, publish what
    `take_readings` returns, log what `take_log` returns.

    Parameters
    ----------
    settings : BridgeSettings
        Rates, limits and the tyre; may be replaced at any time.
    rng : random.Random
        Source of sessions and nonces.
    boot_wait : float
        Silence after opening a port [s].

    Attributes
    ----------
    links : dict of Board to PlcLink
        The two links.
    commands : CommandStream
        The commanders' messages.
    active : bool
        Whether commands are forwarded (lifecycle).
    """

    def __init__(
        self, settings: BridgeSettings, *, rng: random.Random, boot_wait: float = 0.0
    ) -> None:
        self.settings = settings
        self.links = {board: PlcLink(board, rng=rng, boot_wait=boot_wait) for board in BOARDS}
        self.commands = CommandStream()
        self.active = False
        self._enabled = False  # commands are sent with the enable flag
        self._estopped = False  # the operator's e-stop, until the next request to arm
        self._stop_sent_at = -math.inf
        self._gear = Gear.DRIVE
        self._arming: ArmingSequence | None = None
        self._arming_done: Callable[[ArmingOutcome], None] = lambda _: None
        self._log: list[LogEntry] = []
        self._pairing = JointPairing()

    # ---- what the owner asks ----

    @property
    def armed(self) -> bool:
        """Whether both boards were ARMED in their newest telemetry."""
        return all(link.plc_state == PlcState.ARMED for link in self.links.values())

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
        return arming_refusal(self.links, self.commands.newest(now), now, enabled=self._enabled)

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
        was = link.problem
        self._take_events(board, link.closed(reason))
        if reason != was:
            self._warn(f"{board.plc_name}: {reason}")

    def set_command(
        self, command: VehicleCommand, *, stamp: float, now: float, source: Source
    ) -> str | None:
        """Take a commander's message and send it on when it is due.

        Parameters
        ----------
        command : VehicleCommand
            What is wanted; values outside the vehicle's limits are limited.
        stamp : float
            Time at which it was wanted [s].
        now : float
            Time of arrival [s].
        source : Source
            Topic on which it came.

        Returns
        -------
        refusal : str or None
            Why it is refused; None if it was taken.
        """
        refusal = self.commands.add(command, stamp=stamp, now=now, source=source)
        if refusal is None:
            self._send_commands(now)
        return refusal

    def receive(self, board: Board, data: bytes, now: float) -> None:
        """Take bytes from a port.

        Parameters
        ----------
        board : Board
            Board expected behind the port.
        data : bytes
            What arrived, cut anywhere.
        now : float
            Time of arrival [s].
        """
        self._take_events(board, self.links[board].receive(data, now))

    def poll(self, now: float) -> None:
        """Do what is due; to be called after every `receive` and at least every 50 ms."""
        for board, link in self.links.items():
            self._take_events(board, link.poll(now))
        self._check_boards_agree()
        self._send_commands(now)
        self._send_stop(now)
        if self._arming is not None:
            self._arming.advance(now, commanded=self.commands.newest(now) is not None)
            self._finish_arming()

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
            self._enabled = True
            self._estopped = False
            self._arming, self._arming_done = ArmingSequence(self.links, now), done

    def disarm(self, now: float) -> str:
        """Disarm both boards at once (outputs off, brake on); return a text for the operator."""
        self._withdraw("disarmed by the operator")
        return self._operate_all(Op.DISARM, now)

    def emergency_stop(self, now: float) -> str:
        """Latch ESTOP on both boards until the next ARM; return a text for the operator.

        It is sent as an operation and in the flags of every command.
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
            now, repeat_rate=self.settings.command_rate, enabled=self._enabled
        )
        if command is None:
            return
        flags = (CommandFlag.ENABLE if self._enabled else 0) | (
            CommandFlag.ESTOP if self._estopped else 0
        )
        drive = drive_command(command, self.settings, flags, self._gear)
        self._gear = Gear(drive.gear)
        sent = [
            self.links[Board.STEER].send_command(steer_command(command, self.settings, flags)),
            self.links[Board.DRIVE].send_command(drive),
        ]
        if self._arming is not None and all(sent):
            self._arming.count_command()

    def _send_stop(self, now: float) -> None:
        """Send a command that is not enabled to a board that is armed against the operator."""
        if self._enabled or now - self._stop_sent_at < 1.0 / self.settings.command_rate - JITTER:
            return
        for link in self.links.values():
            if link.plc_state == PlcState.ARMED and link.telemetry is not None:
                link.send_command(stop_command(link.telemetry))
                self._stop_sent_at = now

    def _withdraw(self, reason: str) -> None:
        """Send no enabled command any more until the operator's next ARM."""
        if self._enabled:
            self._warn(f"stopped: {reason}")
        self._enabled = False
        self._stop_sent_at = -math.inf
        self._end_arming(ArmingOutcome(False, f"not armed: {reason}"))

    def _operate_all(self, op: Op, now: float) -> str:
        unreached = [board.name.lower() for board, link in self.links.items() if not link.up]
        for link in self.links.values():
            link.operate(op, now)
        missing = f"; no link to the {' and '.join(unreached)} PLC" if unreached else ""
        return f"{op.name} sent{missing}"

    # ---- arming ----

    def _finish_arming(self) -> None:
        if self._arming is None:
            return
        if self._arming.failure is not None:
            self._withdraw(self._arming.failure)
        elif self._arming.complete:
            self._end_arming(ArmingOutcome(True, "armed"))

    def _end_arming(self, outcome: ArmingOutcome) -> None:
        arming, self._arming = self._arming, None
        if arming is not None:
            self._arming_done(outcome)

    # ---- boards ----

    def _check_boards_agree(self) -> None:
        """Stop the other board when one that was armed no longer is."""
        if not self._enabled or self._arming is not None:
            return
        for link in self.links.values():
            if link.plc_state != PlcState.ARMED:
                self._withdraw(board_condition(link))
                return

    def _take_events(self, board: Board, events: list[LinkEvent]) -> None:
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
                case LinkEventKind.LOST | LinkEventKind.REBOOTED:
                    self._warn(event.text)
                    self._withdraw(event.text)
        self._check_boards_agree()

    def _take_telemetry(self, board: Board, event: LinkEvent) -> None:
        if event.state is None:
            return
        reading = joint_reading(event.state, self.links[board].limits, self.settings.tyre_radius)
        if reading is not None:
            partner = Board.DRIVE if board is Board.STEER else Board.STEER
            self._pairing.add(board, reading, event.stamp, partner_up=self.links[partner].up)

    def _take_outcome(self, board: Board, outcome: OperationOutcome) -> None:
        if self._arming is not None and outcome.op in (Op.CLEAR, Op.ARM):
            self._arming.take_outcome(board, outcome)
            self._finish_arming()
        elif outcome.result not in (Result.OK, None):
            self._warn(f"{board.plc_name} refused {outcome.op.name}: {outcome.result.name}")

    def _warn(self, text: str) -> None:
        self._log.append(LogEntry(Level.WARN, text))
