"""One by-wire link as the host sees it: bytes and time in, bytes and events out.

No port and no clock inside: whoever owns the port feeds `PlcLink.receive` and `PlcLink.poll` and
writes what `PlcLink.take_frames` returns. Times are seconds on one monotonic host clock. Section
numbers are those of docs/protocol.md.
"""

from __future__ import annotations

import dataclasses
import enum
import random
from dataclasses import dataclass

from tricycle_bridge.handshake import Handshake
from tricycle_bridge.operations import OperationOutcome, OperationQueue
from tricycle_bridge.protocol.clock import PlcClock, elapsed_us
from tricycle_bridge.protocol.framing import DELIMITER, Frame, FrameDecoder, encode
from tricycle_bridge.protocol.messages import (
    MINOR,
    Ack,
    Board,
    Control,
    DriveCommand,
    DriveLimits,
    DriveState,
    Event,
    EventCode,
    HelloAck,
    LimitsRequest,
    Message,
    Op,
    Ping,
    Pong,
    Stats,
    StatsRequest,
    SteerCommand,
    SteerLimits,
    SteerState,
    echo_of,
)
from tricycle_bridge.protocol.readable import (
    fault_names,
    firmware_version,
    reset_cause_name,
    state_name,
)
from tricycle_core.errors import LinkError

PING_PERIOD = 0.5
"""Time between two PING [s]."""

STATS_PERIOD = 1.0
"""Time between two requests for STATS [s]."""

DEGRADED_AGE = 0.1
"""Age of the newest telemetry from which the link is degraded [s]."""

LOST_AGE = 0.3
"""Age of the newest telemetry from which the link is lost [s]."""

REBOOT_DISAGREEMENT = 1.0
"""Difference of the times that passed for the PLC and for the host, from which it rebooted [s]."""

REFUSED_PAUSE = 1.0
"""Time until a port whose PLC was refused is opened again [s]."""

Telemetry = SteerState | DriveState
BoardCommand = SteerCommand | DriveCommand


class LinkState(enum.Enum):
    """State of a link; the value is its text in messages."""

    CLOSED = "no port"
    BOOTING = "waiting for the bootloader"
    GREETING = "no answer yet"
    UP = "up"
    LOST = "lost"  # the port is to be opened again
    REFUSED = "refused"  # swapped ports or another major version


class LinkEventKind(enum.Enum):
    """Kind of a `LinkEvent`."""

    UP = "up"
    SILENT = "silent"  # no answer to HELLO for HELLO_PATIENCE
    REFUSED = "refused"
    LOST = "lost"
    REBOOTED = "rebooted"
    STATE_CHANGED = "state changed"
    TELEMETRY = "telemetry"
    OPERATION = "operation"  # answered, or given up


@dataclass(frozen=True)
class LinkEvent:
    """Something that happened on a link.

    Attributes
    ----------
    kind : LinkEventKind
        What happened.
    text : str
        Text for a person; empty for TELEMETRY and OPERATION.
    operation : OperationOutcome or None
        Of OPERATION.
    state : SteerState or DriveState or None
        Of TELEMETRY.
    stamp : float
        Time of measurement on the host's clock [s], of TELEMETRY.
    """

    kind: LinkEventKind
    text: str = ""
    operation: OperationOutcome | None = None
    state: Telemetry | None = None
    stamp: float = 0.0


@dataclass
class LinkCounters:
    """What happened on a link, host side; the decoder has counters of its own.

    Attributes
    ----------
    sent : int
        Frames handed to the port.
    write_drops : int
        Frames that the port did not take; counted by the owner of the port.
    seq_gaps : int
        Frames of the PLC that are missing.
    duplicates : int
        Frames of the PLC that came twice.
    reboots : int
        Reboots of the PLC.
    losses : int
        Losses of telemetry.
    """

    sent: int = 0
    write_drops: int = 0
    seq_gaps: int = 0
    duplicates: int = 0
    reboots: int = 0
    losses: int = 0


class PlcLink:
    """Host side of the link to one PLC.

    Parameters
    ----------
    board : Board
        PLC expected behind the port.
    rng : random.Random
        Source of sessions, nonces and tokens.
    boot_wait : float
        Silence after opening [s]: a UNO resets on DTR and stays in its bootloader for about 2 s.

    Attributes
    ----------
    state : LinkState
        State of the link.
    problem : str or None
        What is wrong, for a person; None if nothing is known to be.
    telemetry : SteerState or DriveState or None
        Newest state frame of this session.
    identity : HelloAck or None
        What the PLC answered to HELLO in this session.
    answered_by : Board or None
        PLC that answered the last handshake, also one that was refused.
    limits : SteerLimits or DriveLimits or None
        What the PLC answered to LIMITS_REQ in this session.
    stats : Stats or None
        Newest counters of the PLC.
    clock : PlcClock
        The PLC's clock.
    decoder : FrameDecoder
        Decoder of what the port receives; it holds the session and its own counters.
    counters : LinkCounters
        What happened on the link.
    """

    def __init__(self, board: Board, *, rng: random.Random, boot_wait: float = 0.0) -> None:
        self.board = board
        self.boot_wait = boot_wait
        self.counters = LinkCounters()
        self.decoder = FrameDecoder(board, host=True)
        self.state = LinkState.CLOSED
        self.problem: str | None = None
        self.clock = PlcClock()
        self.identity: HelloAck | None = None
        self.answered_by: Board | None = None
        self.telemetry: Telemetry | None = None
        self.limits: SteerLimits | DriveLimits | None = None
        self.stats: Stats | None = None
        self._rng = rng
        self._handshake = Handshake(board, rng=rng)
        self._operations = OperationQueue(lambda op: self._send(Control.of(op)))
        self._frames: list[bytes] = []
        self._events: list[LinkEvent] = []
        self._seq = 0
        self._last_rx_seq: int | None = None
        self._next_ping = 0.0
        self._next_stats = 0.0
        self._telemetry_at = 0.0
        self._refused_at = 0.0
        self._refusal: str | None = None  # of the last handshake
        self._pings: dict[int, float] = {}  # token -> time sent

    # ---- what the owner asks ----

    @property
    def up(self) -> bool:
        """Whether the PLC may be commanded."""
        return self.state is LinkState.UP

    @property
    def plc_state(self) -> int | None:
        """State of the PLC in the newest telemetry; None without telemetry."""
        return None if self.telemetry is None else self.telemetry.state

    @property
    def down_reason(self) -> str:
        """Why there is no telemetry, for a person."""
        return self.problem or ("no telemetry yet" if self.up else self.state.value)

    def telemetry_age(self, now: float) -> float:
        """Return the age of the newest state frame [s]; infinite while the link is not up."""
        return now - self._telemetry_at if self.up else float("inf")

    def wants_reopen(self, now: float) -> bool:
        """Whether the port should be closed and opened again."""
        if self.state is LinkState.REFUSED:
            return now - self._refused_at >= REFUSED_PAUSE
        return self.state is LinkState.LOST

    # ---- what the owner does ----

    def opened(self, now: float) -> None:
        """Begin the handshake on a port that was just opened."""
        self.decoder.reset()
        self.problem = self._refusal  # valid until this handshake has an outcome
        self.state = LinkState.BOOTING
        self._start_handshake(now + self.boot_wait)

    def closed(self, reason: str) -> list[LinkEvent]:
        """End the session, because the port is gone."""
        if self.up:
            self._add_event(LinkEventKind.LOST, f"{self.board.plc_name}: {reason}")
        self._forget_session()
        self._frames.clear()
        self.state = LinkState.CLOSED
        self.problem = reason
        return self._take_events()

    def send_command(self, command: BoardCommand) -> bool:
        """Send a command with the echo of the newest telemetry; False while the link is not up.

        Raises
        ------
        LinkError
            The command is for the other board, or a value does not fit its field.
        """
        if self.board != command.BOARD:
            raise LinkError(f"{type(command).__name__} sent to the {self.board.plc_name}")
        if not self.up or self.telemetry is None:
            return False
        self._send(dataclasses.replace(command, echo=echo_of(self.telemetry.t)))
        return True

    def operate(self, op: Op, now: float) -> None:
        """Send an operation after those still unanswered; ESTOP and DISARM replace them.

        An OPERATION event gives the outcome. Nothing happens while the link is not up.

        Parameters
        ----------
        op : Op
            The operation.
        now : float
            Present time [s].
        """
        if self.up:
            self._operations.add(op, now)

    def take_frames(self) -> list[bytes]:
        """Return the frames to write since the last call, oldest first."""
        frames, self._frames = self._frames, []
        self.counters.sent += len(frames)
        return frames

    def receive(self, data: bytes, now: float) -> list[LinkEvent]:
        """Take bytes from the port.

        Parameters
        ----------
        data : bytes
            What arrived, cut anywhere.
        now : float
            Time of arrival [s].
        """
        if self.state not in (LinkState.CLOSED, LinkState.REFUSED):
            for frame in self.decoder.feed(data):
                self._handle(frame, now)
        return self._take_events()

    def poll(self, now: float) -> list[LinkEvent]:
        """Do what is due; to be called at least every 50 ms, after `receive`."""
        if self.state is LinkState.BOOTING and now >= self._handshake.begins_at:
            self._frames.append(DELIMITER)  # resynchronises the PLC's decoder
            self.state = LinkState.GREETING
        if self.state is LinkState.GREETING:
            self._poll_handshake(now)
        elif self.up:
            self._poll_up(now)
        return self._take_events()

    # ---- frames and events ----

    def _send(self, message: Message, *, board: Board | None = None) -> int:
        """Encode and queue a message; return the sequence number of its frame."""
        seq = self._seq
        self._frames.append(
            encode(message, board=board or self.board, seq=seq, session=self.decoder.session)
        )
        self._seq = (seq + 1) & 0xFF
        return seq

    def _take_events(self) -> list[LinkEvent]:
        events, self._events = self._events, []
        return events

    def _add_event(self, kind: LinkEventKind, text: str) -> None:
        self._events.append(LinkEvent(kind, text))

    def _add_outcome(self, outcome: OperationOutcome | None) -> None:
        if outcome is not None:
            self._events.append(LinkEvent(LinkEventKind.OPERATION, operation=outcome))

    # ---- handshake ----

    def _forget_session(self) -> None:
        self.identity = self.telemetry = self.limits = None
        self._operations.clear()
        self._pings.clear()
        self.clock = PlcClock()
        self._last_rx_seq = None

    def _start_handshake(self, at: float) -> None:
        self._forget_session()
        self.decoder.session = self._handshake.new_session(self.decoder.session)
        self._handshake.start(at)

    def _poll_handshake(self, now: float) -> None:
        if (hello := self._handshake.due(now)) is not None:
            self._send(hello, board=Board(hello.board))
        if self._handshake.falls_silent(now):
            self._refusal = None
            self.problem = f"no {self.board.plc_name} answers ({self._line_report()})"
            self._add_event(LinkEventKind.SILENT, self.problem)

    def _line_report(self) -> str:
        counters = self.decoder.counters
        return (
            f"{self._handshake.sent} HELLO sent, {counters.ok} good frames, {counters.crc} CRC, "
            f"{counters.cobs} COBS, {counters.length} length, {counters.unknown} unknown, "
            f"{counters.version} version, {counters.session} session errors"
        )

    def _answered(self, frame: Frame, ack: HelloAck, now: float) -> None:
        self.answered_by = frame.board
        self.problem = self._refusal = self._handshake.refusal(frame, ack)
        if self._refusal is not None:
            self.state = LinkState.REFUSED
            self._refused_at = now
            self._frames.clear()
            self._add_event(LinkEventKind.REFUSED, self._refusal)
            return
        self.state = LinkState.UP
        self.identity = ack
        self._last_rx_seq = frame.seq
        self._telemetry_at = self._next_ping = self._next_stats = now
        minor = "" if ack.minor == MINOR else f", minor {min(ack.minor, MINOR)} is used"
        self._add_event(
            LinkEventKind.UP,
            f"{self.board.plc_name}: firmware {firmware_version(ack)}, boot {ack.boot_count}, "
            f"last reset: {reset_cause_name(ack.reset_cause)}{minor}",
        )

    def _rebooted(self, now: float, how: str) -> None:
        self.counters.reboots += 1
        self._add_event(LinkEventKind.REBOOTED, f"{self.board.plc_name} rebooted: {how}")
        self.problem = "the PLC rebooted"
        self._frames.clear()
        self.state = LinkState.GREETING
        self._start_handshake(now)

    # ---- up ----

    def _poll_up(self, now: float) -> None:
        if now - self._telemetry_at > LOST_AGE:
            self.counters.losses += 1
            self.problem = f"no telemetry for {now - self._telemetry_at:.2f} s"
            self._add_event(LinkEventKind.LOST, f"{self.board.plc_name}: {self.problem}")
            self._forget_session()
            self.state = LinkState.LOST
            return
        if now >= self._next_ping:
            self._next_ping = now + PING_PERIOD
            token = self._rng.getrandbits(32)
            self._pings = {t: at for t, at in self._pings.items() if now - at < 4 * PING_PERIOD}
            self._pings[token] = now
            self._send(Ping(token))
        if now >= self._next_stats:
            self._next_stats = now + STATS_PERIOD
            self._send(StatsRequest())
            if self.limits is None:
                self._send(LimitsRequest())
        self._add_outcome(self._operations.poll(now))

    def _handle(self, frame: Frame, now: float) -> None:
        message = frame.message
        if isinstance(message, HelloAck):
            if self.state is LinkState.GREETING and self._handshake.is_answered_by(message):
                self._answered(frame, message, now)
            return
        if not self.up:
            return
        if frame.session == 0 or (isinstance(message, Event) and message.code == EventCode.BOOT):
            self._rebooted(now, "its session is gone")
            return
        if not self._count_seq(frame.seq):
            return
        match message:
            case SteerState() | DriveState():
                self._handle_telemetry(message, now)
            case Pong():
                sent_at = self._pings.pop(message.token, None)
                if sent_at is not None:
                    self.clock.add_ping(sent_at, message.t_rx, message.t_tx, now)
            case Ack():
                self._add_outcome(self._operations.acknowledge(message, now))
            case SteerLimits() | DriveLimits():
                self.limits = message
            case Stats():
                self.stats = message
            case Event():
                self._add_event(LinkEventKind.STATE_CHANGED, self._describe_change(message))

    def _count_seq(self, seq: int) -> bool:
        """Count gaps and duplicates (section 4); False for a duplicate."""
        if self._last_rx_seq is not None:
            step = (seq - self._last_rx_seq) & 0xFF
            if step == 0:
                self.counters.duplicates += 1
                return False
            self.counters.seq_gaps += step - 1
        self._last_rx_seq = seq
        return True

    def _handle_telemetry(self, state: Telemetry, now: float) -> None:
        if self.telemetry is not None:
            on_plc = elapsed_us(state.t, self.telemetry.t) * 1e-6
            here = now - self._telemetry_at
            if abs(on_plc - here) > REBOOT_DISAGREEMENT:
                self._rebooted(now, f"its clock moved {on_plc:.2f} s in {here:.2f} s")
                return
        self.telemetry = state
        self._telemetry_at = now
        stamp = self.clock.to_host(state.t, received=now)
        self._events.append(LinkEvent(LinkEventKind.TELEMETRY, state=state, stamp=stamp))

    def _describe_change(self, event: Event) -> str:
        old, new = event.states >> 4, event.states & 0x0F
        faults = f" ({fault_names(event.faults)})" if event.faults else ""
        return f"{self.board.plc_name}: {state_name(old)} to {state_name(new)}{faults}"
