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
from typing import NamedTuple

from tricycle_bridge.plc_link.handshake import Handshake
from tricycle_bridge.plc_link.operations import OperationOutcome, OperationQueue
from tricycle_bridge.protocol.clock import PlcClock, elapsed_us
from tricycle_bridge.protocol.framing import DELIMITER, Frame, FrameDecoder, encode
from tricycle_bridge.protocol.messages import (
    MINOR,
    NEW_STATE_MASK,
    OLD_STATE_SHIFT,
    Ack,
    Board,
    Control,
    DriveCommand,
    DriveLimits,
    DriveSetup,
    DriveState,
    Event,
    EventCode,
    HelloAck,
    LimitsRequest,
    Message,
    Op,
    Ping,
    PlcState,
    Pong,
    Result,
    Stats,
    StatsRequest,
    SteerCommand,
    SteerLimits,
    SteerSetup,
    SteerState,
    echo_of,
)
from tricycle_bridge.protocol.readable import (
    fault_names,
    firmware_version,
    readable_value,
    reset_cause_name,
    state_name,
)
from tricycle_core.errors import LinkError

PING_PERIOD = 0.5
"""Time between two PING [s]."""

FIRST_PING_PERIOD = 0.07
"""Time between two PING until the PLC's clock is settled [s]; apart from LIMITS_REQ, STATS_REQ."""

STATS_PERIOD = 1.0
"""Time between two requests for STATS [s]."""

DEGRADED_AGE = 0.1
"""Age of the newest telemetry from which the link is degraded [s]."""

LOST_AGE = 0.3
"""Age of the newest telemetry from which the link is lost [s]."""

REBOOT_DISAGREEMENT = 1.0
"""Difference of the times that passed for the PLC and for the host, from which it rebooted [s]."""

REFUSED_PAUSE = 1.0
"""Time until a PLC that was refused is asked again [s]."""

REOPEN_AFTER = 3
"""Handshakes without an answer until the port is opened again, which resets a UNO."""

REQUEST_GAP = 0.1
"""Time between a request for LIMITS and one for STATS [s]: a PLC may answer little in a tick."""

SETUP_PAUSE = 1.0
"""Time until a PLC that gave no answer to SETUP, or was not ready for it, is asked again [s]."""

Telemetry = SteerState | DriveState
BoardCommand = SteerCommand | DriveCommand
BoardSetup = SteerSetup | DriveSetup
BoardLimits = SteerLimits | DriveLimits

# Fields of SETUP that a PLC refuses where they are larger than its own.
_BOUNDED = (
    "max_angle",
    "max_rate",
    "max_speed",
    "max_acceleration",
    "torque",
    "regenerative_torque",
    "power",
)


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
    SETUP_FAILED = "set-up failed"
    LOST = "lost"
    REBOOTED = "rebooted"
    STATE_CHANGED = "state changed"
    TELEMETRY = "telemetry"
    OPERATION = "operation"  # answered, or given up


class LinkEvent(NamedTuple):
    """Something that happened on a link.

    Attributes
    ----------
    kind : LinkEventKind
        Kind of the event.
    text : str
        Text for a person; empty for TELEMETRY and OPERATION.
    operation : OperationOutcome or None
        For OPERATION: how the operation ended.
    state : SteerState or DriveState or None
        For TELEMETRY: state that the board reports.
    stamp : float
        For TELEMETRY: time of measurement on the host's clock [s].
    """

    kind: LinkEventKind
    text: str = ""
    operation: OperationOutcome | None = None
    state: Telemetry | None = None
    stamp: float = 0.0


@dataclass
class LinkCounters:
    """Counters of a link on the host's side; the decoder has counters of its own.

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
    setup : SteerSetup or DriveSetup, optional
        Message that sets up the PLC for the vehicle in each session; without it the PLC cannot be
        armed.
    simulated : bool
        Whether the host's time is simulated.

    Attributes
    ----------
    state : LinkState
        State of the link.
    problem : str or None
        Problem of the link, for a person; None if none is known.
    set_up : bool
        Whether the PLC acknowledged its set-up in this session.
    setup_out_of_range : bool
        Whether the PLC refused its set-up in this session because a value is out of its range.
    telemetry : SteerState or DriveState or None
        Newest state frame of this session.
    identity : HelloAck or None
        The PLC's answer to HELLO in this session.
    answered_by : Board or None
        PLC that answered the last handshake, also one that was refused.
    limits : SteerLimits or DriveLimits or None
        Limits in force, as the PLC answered to LIMITS_REQ in this session.
    stats : Stats or None
        Newest counters of the PLC.
    clock : PlcClock
        The PLC's clock.
    decoder : FrameDecoder
        Decoder of what the port receives; it holds the session and its own counters.
    counters : LinkCounters
        Counters of the link on the host's side.
    """

    def __init__(
        self,
        board: Board,
        *,
        rng: random.Random,
        boot_wait: float = 0.0,
        setup: BoardSetup | None = None,
        simulated: bool = False,
    ) -> None:
        self.board = board
        self._simulated = simulated
        self.setup = setup
        self.set_up = False
        self.setup_out_of_range = False
        self.boot_wait = boot_wait
        self.counters = LinkCounters()
        self.decoder = FrameDecoder(board, host=True)
        self.state = LinkState.CLOSED
        self.problem: str | None = None
        self.clock = PlcClock(simulated=self._simulated)
        self.identity: HelloAck | None = None
        self.answered_by: Board | None = None
        self.telemetry: Telemetry | None = None
        self.limits: BoardLimits | None = None
        self.stats: Stats | None = None
        self._rng = rng
        self._handshake = Handshake(board, rng=rng)
        self._operations = OperationQueue(self._send_operation)
        self._frames: list[bytes] = []
        self._events: list[LinkEvent] = []
        self._seq = 0
        self._last_rx_seq: int | None = None
        self._next_ping = 0.0
        self._next_stats = 0.0
        self._next_limits = 0.0
        self._next_setup = 0.0
        self._unanswered = 0  # handshakes since the port was opened
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

    @property
    def wants_reopen(self) -> bool:
        """Whether the port should be closed and opened again, because nothing else helped."""
        return self.state is LinkState.LOST

    # ---- what the owner does ----

    def opened(self, now: float) -> None:
        """Begin the handshake on a port that was just opened."""
        self.decoder.reset()
        self.problem = self._refusal  # valid until this handshake has an outcome
        self.state = LinkState.BOOTING
        self._unanswered = 0
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
        self._send(command.echoing(self.telemetry.t))
        return True

    def operate(self, op: Op, now: float) -> None:
        """Send an operation after those still unanswered; ESTOP and DISARM replace them.

        An OPERATION event gives the outcome. Nothing happens while the link is not up.

        Parameters
        ----------
        op : Op
            Operation, e.g. ARM.
        now : float
            Present time [s].
        """
        if self.up:
            self._operations.add(op, now)

    def forget_operations(self) -> None:
        """Send no operation again that is not answered yet."""
        self._operations.clear()

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
            Received bytes; they may begin and end anywhere in a frame.
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
        elif self.state is LinkState.REFUSED and now - self._refused_at >= REFUSED_PAUSE:
            self._greet_again(now)
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

    def _send_operation(self, op: Op, number: int) -> int:
        if op is Op.SETUP and self.setup is not None:
            return self._send(self.setup)
        echo = 0 if self.telemetry is None else echo_of(self.telemetry.t)
        return self._send(Control.of(op, number, echo))

    def _take_events(self) -> list[LinkEvent]:
        events, self._events = self._events, []
        return events

    def _add_event(self, kind: LinkEventKind, text: str) -> None:
        self._events.append(LinkEvent(kind, text))

    def _take_outcome(self, outcome: OperationOutcome | None, now: float) -> None:
        if outcome is None:
            return
        if outcome.op is Op.SETUP:
            self._take_setup_result(outcome.result, now)
        else:
            self._events.append(LinkEvent(LinkEventKind.OPERATION, operation=outcome))

    # ---- handshake ----

    def _forget_session(self) -> None:
        self.identity = self.telemetry = self.limits = None
        self.set_up = self.setup_out_of_range = False
        self._operations.clear()
        self._pings.clear()
        self.clock = PlcClock(simulated=self._simulated)
        self._last_rx_seq = None

    def _start_handshake(self, at: float) -> None:
        self._forget_session()
        self.decoder.session = self._handshake.new_session(self.decoder.session)
        self._handshake.start(at)

    def _greet_again(self, now: float) -> None:
        """Repeat the handshake on the open port: opening it anew would reset a UNO."""
        self._frames.clear()
        self.state = LinkState.GREETING
        self._start_handshake(now)

    def _poll_handshake(self, now: float) -> None:
        if (hello := self._handshake.due(now)) is not None:
            self._send(hello, board=Board(hello.board))
        if self._handshake.falls_silent(now):
            self._refusal = None
            self.problem = f"no {self.board.plc_name} answers ({self._line_report()})"
            if self._unanswered == 0:
                self._add_event(LinkEventKind.SILENT, self.problem)
            self._unanswered += 1
            if self._unanswered == REOPEN_AFTER:
                self.state = LinkState.LOST
            else:
                self._handshake.start(now)

    def _line_report(self) -> str:
        counters = self.decoder.counters
        return (
            f"{self._handshake.sent} HELLO sent, {counters.ok} good frames, {counters.crc} CRC, "
            f"{counters.cobs} COBS, {counters.length} length, {counters.unknown} unknown, "
            f"{counters.version} version, {counters.session} session errors"
        )

    def _answered(self, frame: Frame, ack: HelloAck, now: float) -> None:
        self.answered_by = frame.board
        known = self._refusal
        self.problem = self._refusal = self._handshake.refusal(frame, ack)
        if self._refusal is not None:
            self.state = LinkState.REFUSED
            self._refused_at = now
            self._frames.clear()
            if self._refusal != known:
                self._add_event(LinkEventKind.REFUSED, self._refusal)
            return
        self.state = LinkState.UP
        self.identity = ack
        self._last_rx_seq = frame.seq
        self._unanswered = 0
        self._telemetry_at = self._next_ping = self._next_setup = now
        self._next_limits = now + REQUEST_GAP
        self._next_stats = now + 2.5 * REQUEST_GAP  # between two PING, whose answer is long too
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
        self._greet_again(now)

    # ---- up ----

    def _poll_up(self, now: float) -> None:
        if now - self._telemetry_at > LOST_AGE:
            self.counters.losses += 1
            self.problem = f"no telemetry for {now - self._telemetry_at:.2f} s"
            self._add_event(LinkEventKind.LOST, f"{self.board.plc_name}: {self.problem}")
            self._greet_again(now)
            return
        if now >= self._next_ping:
            self._next_ping = now + (PING_PERIOD if self.clock.settled else FIRST_PING_PERIOD)
            token = self._rng.getrandbits(32)
            self._pings = {t: at for t, at in self._pings.items() if now - at < 4 * PING_PERIOD}
            self._pings[token] = now
            self._send(Ping(token))
        if self.limits is None or now >= self._next_stats:
            self._poll_requests(now)
        if not self.set_up:
            self._poll_setup(now)
        if self._operations.busy:
            self._take_outcome(self._operations.poll(now), now)

    def _poll_requests(self, now: float) -> None:
        """Ask for LIMITS and STATS, never for both at once: a PLC answers little in a tick."""
        unknown = self.limits is None and not self._operations.includes(Op.SETUP)
        if unknown and now >= self._next_limits:
            self._next_limits = now + STATS_PERIOD
            self._next_stats = max(self._next_stats, now + REQUEST_GAP)
            self._send(LimitsRequest())
        elif now >= self._next_stats:
            self._next_stats = now + STATS_PERIOD
            self._next_limits = max(self._next_limits, now + REQUEST_GAP)
            self._send(StatsRequest())

    # ---- set-up ----

    def _poll_setup(self, now: float) -> None:
        """Send SETUP once per session, when the PLC can take it: in SAFE."""
        wanted = self.setup is not None and not self.set_up and not self.setup_out_of_range
        if (
            wanted
            and self.plc_state == PlcState.SAFE
            and now >= self._next_setup
            and not self._operations.includes(Op.SETUP)
        ):
            self._next_setup = now + SETUP_PAUSE
            self._operations.add(Op.SETUP, now)

    def _take_setup_result(self, result: Result | None, now: float) -> None:
        self.set_up = result is Result.OK
        self.limits = None  # others are in force, or are to be compared
        self._next_limits = now
        if self.set_up:
            self.problem = None
            return
        if result is None:
            self.problem = f"{self.board.plc_name} did not acknowledge its set-up"
        else:
            why = result.name.lower().replace("_", " ")
            self.problem = f"{self.board.plc_name} refused its set-up: {why}"
        self.setup_out_of_range = result is Result.OUT_OF_RANGE
        if not self.setup_out_of_range:
            self._add_event(LinkEventKind.SETUP_FAILED, self.problem)

    def _take_limits(self, limits: BoardLimits) -> None:
        first, self.limits = self.limits is None, limits
        if not (first and self.setup_out_of_range and self.setup is not None):
            return
        self.problem = f"{self.board.plc_name} refused its set-up: out of range"
        known = {f.name for f in dataclasses.fields(limits)}
        exceeded = ", ".join(
            f"{name} {readable_value(self.setup, name)}, "
            f"the board allows {readable_value(limits, name)}"
            for name in _BOUNDED
            if name in known and getattr(self.setup, name) > getattr(limits, name)
        )
        if exceeded:
            self.problem += f": {exceeded}"
        self._add_event(LinkEventKind.SETUP_FAILED, self.problem)

    # ---- what the PLC sends ----

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
                self._take_outcome(self._operations.acknowledge(message, now), now)
            case SteerLimits() | DriveLimits():
                self._take_limits(message)
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
        old, new = event.states >> OLD_STATE_SHIFT, event.states & NEW_STATE_MASK
        faults = f" ({fault_names(event.faults)})" if event.faults else ""
        return f"{self.board.plc_name}: {state_name(old)} to {state_name(new)}{faults}"
