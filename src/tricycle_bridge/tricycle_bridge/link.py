"""One by-wire link as the host sees it: bytes and time in, bytes and events out.

No port and no clock inside: whoever owns the port feeds `PlcLink.receive` and `PlcLink.poll` and
writes what `PlcLink.take_frames` returns. Times are seconds on one monotonic host clock.
"""

from __future__ import annotations

import dataclasses
import enum
import random
from dataclasses import dataclass

from tricycle_bridge.protocol.clock import PlcClock, elapsed_us
from tricycle_bridge.protocol.framing import DELIMITER, Frame, FrameDecoder, encode
from tricycle_bridge.protocol.messages import (
    MAJOR,
    MINOR,
    Ack,
    Board,
    Control,
    DriveCommand,
    DriveLimits,
    DriveState,
    Event,
    EventCode,
    Hello,
    HelloAck,
    LimitsRequest,
    Message,
    Op,
    Ping,
    PlcState,
    Pong,
    ResetCause,
    Result,
    Stats,
    StatsRequest,
    SteerCommand,
    SteerLimits,
    SteerState,
    echo_of,
    fault_names,
)
from tricycle_core.errors import LinkError

HELLO_PERIOD = 0.2  # s
HELLO_PATIENCE = 3.0  # s without an answer until it is reported
PING_PERIOD = 0.5  # s
STATS_PERIOD = 1.0  # s
CTRL_PERIOD = 0.05  # s until CTRL is resent
CTRL_RESENDS = 3
DEGRADED_AGE = 0.1  # s, of the newest telemetry
LOST_AGE = 0.3  # s
REBOOT_DISAGREEMENT = 1.0  # s between the PLC's elapsed time and ours
REFUSED_PAUSE = 1.0  # s until a refused port is tried again

State = SteerState | DriveState
Command = SteerCommand | DriveCommand


class LinkState(enum.Enum):
    """State of a link; the value is what a person reads."""

    CLOSED = "no port"
    BOOTING = "waiting for the bootloader"
    GREETING = "no answer yet"
    UP = "up"
    LOST = "lost"  # reopen the port
    REFUSED = "refused"  # swapped ports or another major version: reopen later


class LinkEventKind(enum.Enum):
    """What a link tells its owner."""

    UP = "up"
    SILENT = "silent"  # nobody answered HELLO for HELLO_PATIENCE
    REFUSED = "refused"
    LOST = "lost"
    REBOOTED = "rebooted"
    STATE_CHANGED = "state changed"
    TELEMETRY = "telemetry"
    CONTROLLED = "controlled"  # CTRL was answered, or given up


@dataclass(frozen=True)
class Controlled:
    """Outcome of CTRL; `result` is None when nobody answered."""

    op: Op
    result: Result | None


@dataclass(frozen=True)
class LinkEvent:
    """Something the owner of a link wants to know."""

    kind: LinkEventKind
    text: str = ""  # for a person
    controlled: Controlled | None = None
    state: State | None = None  # of TELEMETRY
    stamp: float = 0.0  # s, host time of measurement, of TELEMETRY


@dataclass
class LinkCounters:
    """What happened on a link, host side; the decoder has its own counters."""

    sent: int = 0  # frames handed to the port
    write_drops: int = 0  # frames that the port did not take (counted by its owner)
    seq_gaps: int = 0  # frames of the PLC that never came
    duplicates: int = 0
    reboots: int = 0
    losses: int = 0  # of telemetry


@dataclass
class _PendingControl:
    op: Op
    sent_at: float
    seqs: list[int]  # of the first sending and the resends


class PlcLink:
    """Host side of the link to one PLC.

    Parameters
    ----------
    board
        The PLC expected behind the port.
    rng
        Source of sessions and nonces.
    boot_wait
        Seconds of silence after opening: a UNO resets on DTR and stays in its bootloader for ~2 s.
    """

    def __init__(self, board: Board, *, rng: random.Random, boot_wait: float = 0.0) -> None:
        self.board = board
        self.boot_wait = boot_wait
        self.counters = LinkCounters()
        self.decoder = FrameDecoder(board, host=True)
        self.state = LinkState.CLOSED
        self.problem = ""  # why the link is not up, for a person
        self.clock = PlcClock()
        self.identity: HelloAck | None = None
        self.answered_by: Board | None = None  # of the last handshake, also where it was refused
        self.telemetry: State | None = None  # of this session
        self.limits: SteerLimits | DriveLimits | None = None
        self.stats: Stats | None = None
        self._rng = rng
        self._frames: list[bytes] = []
        self._events: list[LinkEvent] = []
        self._seq = 0
        self._last_rx_seq: int | None = None
        self._nonce = 0
        self._hellos = 0
        self._greeting_since = 0.0
        self._reported_silent = False
        self._next_hello = 0.0
        self._next_ping = 0.0
        self._next_stats = 0.0
        self._telemetry_at = 0.0
        self._refused_at = 0.0
        self._refusal = ""  # of the last handshake
        self._pings: dict[int, float] = {}  # token -> time sent
        self._control: _PendingControl | None = None
        self._queued_ops: list[Op] = []

    # ---- what the owner asks ----

    @property
    def up(self) -> bool:
        """Whether the PLC may be commanded."""
        return self.state is LinkState.UP

    @property
    def trouble(self) -> str:
        """Why there is no telemetry."""
        return self.problem or ("no telemetry yet" if self.up else self.state.value)

    def telemetry_age(self, now: float) -> float:
        """Seconds since the newest state frame; infinite while the link is not up."""
        return now - self._telemetry_at if self.up else float("inf")

    def wants_reopen(self, now: float) -> bool:
        """Whether the port should be closed and opened anew."""
        if self.state is LinkState.REFUSED:
            return now - self._refused_at >= REFUSED_PAUSE
        return self.state is LinkState.LOST

    # ---- what the owner does ----

    def opened(self, now: float) -> None:
        """Begin on a port that was just opened."""
        self.decoder.reset()
        self.problem = self._refusal  # holds until this handshake says otherwise
        self.state = LinkState.BOOTING
        self._start_greeting(now + self.boot_wait)

    def closed(self, reason: str) -> list[LinkEvent]:
        """End: the port is gone."""
        if self.up:
            self._events.append(LinkEvent(LinkEventKind.LOST, f"{self._name} PLC: {reason}"))
        self._forget_session()
        self._frames.clear()
        self.state = LinkState.CLOSED
        self.problem = reason
        return self._take_events()

    def send_command(self, command: Command) -> bool:
        """Send a set-point with the echo of the newest telemetry; False while the link is not up.

        Raises
        ------
        LinkError
            The command is for the other board, or a value does not fit its field.
        """
        if self.board != command.BOARD:
            raise LinkError(f"{type(command).__name__} sent to the {self._name} PLC")
        if not self.up or self.telemetry is None:
            return False
        self._send(dataclasses.replace(command, echo=echo_of(self.telemetry.t)))
        return True

    def control(self, op: Op, now: float) -> None:
        """Send an operation, after those still unanswered.

        ESTOP and DISARM go out at once and supersede the others. A `CONTROLLED` event tells the
        outcome; nothing happens while the link is not up.
        """
        if not self.up:
            return
        if op in (Op.ESTOP, Op.DISARM):
            self._queued_ops.clear()
            self._control = None
        self._queued_ops.append(op)
        self._next_control(now)

    def take_frames(self) -> list[bytes]:
        """Return the frames to write, oldest first; they are then the owner's."""
        frames, self._frames = self._frames, []
        self.counters.sent += len(frames)
        return frames

    def receive(self, data: bytes, now: float) -> list[LinkEvent]:
        """Take bytes from the port."""
        if self.state not in (LinkState.CLOSED, LinkState.REFUSED):
            for frame in self.decoder.feed(data):
                self._handle(frame, now)
        return self._take_events()

    def poll(self, now: float) -> list[LinkEvent]:
        """Do what is due; call it at least every 50 ms, after `receive` of what has arrived."""
        if self.state is LinkState.BOOTING and now >= self._next_hello:
            self._frames.append(DELIMITER)  # resynchronises the PLC's decoder
            self.state = LinkState.GREETING
        if self.state is LinkState.GREETING:
            self._poll_greeting(now)
        elif self.up:
            self._poll_up(now)
        return self._take_events()

    # ---- inside ----

    @property
    def _name(self) -> str:
        return self.board.name.lower()

    def _take_events(self) -> list[LinkEvent]:
        events, self._events = self._events, []
        return events

    def _send(self, message: Message, *, board: Board | None = None) -> int:
        """Encode and queue; returns the frame's seq."""
        seq = self._seq
        self._frames.append(
            encode(message, board=board or self.board, seq=seq, session=self.decoder.session)
        )
        self._seq = (seq + 1) & 0xFF
        return seq

    def _forget_session(self) -> None:
        self.identity = self.telemetry = self.limits = None
        self._control = None
        self._queued_ops.clear()
        self._pings.clear()
        self.clock = PlcClock()
        self._last_rx_seq = None

    def _start_greeting(self, at: float) -> None:
        self._forget_session()
        old = self.decoder.session
        while self.decoder.session == old:
            self.decoder.session = self._rng.randint(1, 255)
        self._hellos = 0
        self._greeting_since = self._next_hello = at
        self._reported_silent = False

    def _poll_greeting(self, now: float) -> None:
        if now >= self._next_hello:
            # Every second one asks any board: only so does a swapped PLC answer with its name.
            wanted = self.board if self._hellos % 2 == 0 else Board.ANY
            self._hellos += 1
            self._nonce = self._rng.getrandbits(32)
            self._send(Hello(MINOR, wanted, self._nonce), board=wanted)
            self._next_hello = now + HELLO_PERIOD
        if now - self._greeting_since >= HELLO_PATIENCE and not self._reported_silent:
            self._reported_silent = True
            self._refusal = ""
            self.problem = f"no {self._name} PLC answers ({self._line_report()})"
            self._events.append(LinkEvent(LinkEventKind.SILENT, self.problem))

    def _line_report(self) -> str:
        counters = self.decoder.counters
        return (
            f"{self._hellos} HELLO sent, {counters.ok} good frames, {counters.crc} CRC, "
            f"{counters.cobs} COBS, {counters.length} length, {counters.unknown} unknown, "
            f"{counters.version} version, {counters.session} session errors"
        )

    def _poll_up(self, now: float) -> None:
        if now - self._telemetry_at > LOST_AGE:
            self.counters.losses += 1
            self.problem = f"no telemetry for {now - self._telemetry_at:.2f} s"
            self._events.append(LinkEvent(LinkEventKind.LOST, f"{self._name} PLC: {self.problem}"))
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
        self._next_control(now)

    def _next_control(self, now: float) -> None:
        """Send the next operation, resend the pending one, or give it up."""
        pending = self._control
        if pending is None:
            if not self._queued_ops:
                return
            op = self._queued_ops.pop(0)
            self._control = _PendingControl(op, now, [self._send(Control.of(op))])
        elif now - pending.sent_at >= CTRL_PERIOD:
            if len(pending.seqs) > CTRL_RESENDS:
                self._finish_control(None)
            else:
                pending.sent_at = now
                pending.seqs.append(self._send(Control.of(pending.op)))

    def _finish_control(self, result: Result | None) -> None:
        if self._control is not None:
            outcome = Controlled(self._control.op, result)
            self._events.append(LinkEvent(LinkEventKind.CONTROLLED, controlled=outcome))
            self._control = None

    def _handle(self, frame: Frame, now: float) -> None:
        message = frame.message
        if isinstance(message, HelloAck):
            if self.state is LinkState.GREETING and message.nonce == self._nonce:
                self._greeted(frame, message, now)
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
                self._handle_state(message, now)
            case Pong():
                sent_at = self._pings.pop(message.token, None)
                if sent_at is not None:
                    self.clock.add_ping(sent_at, message.t_rx, message.t_tx, now)
            case Ack():
                pending = self._control
                if (
                    pending is not None
                    and message.op == pending.op
                    and message.ctrl_seq in pending.seqs
                ):
                    self._finish_control(_result_of(message.result))
                    self._next_control(now)
            case SteerLimits() | DriveLimits():
                self.limits = message
            case Stats():
                self.stats = message
            case Event():
                self._events.append(
                    LinkEvent(LinkEventKind.STATE_CHANGED, self._describe_change(message))
                )

    def _count_seq(self, seq: int) -> bool:
        """Count gaps and duplicates; False for a duplicate."""
        if self._last_rx_seq is not None:
            step = (seq - self._last_rx_seq) & 0xFF
            if step == 0:
                self.counters.duplicates += 1
                return False
            self.counters.seq_gaps += step - 1
        self._last_rx_seq = seq
        return True

    def _greeted(self, frame: Frame, ack: HelloAck, now: float) -> None:
        self.answered_by = frame.board
        if frame.major != MAJOR:
            self._refuse(
                f"the PLC speaks protocol version {frame.major}, this bridge {MAJOR}: "
                f"update its firmware",
                now,
            )
        elif frame.board != self.board or ack.board != self.board:
            self._refuse(
                f"ports swapped: the {frame.board.name.lower()} PLC answers where the "
                f"{self._name} PLC should be",
                now,
            )
        else:
            self.state = LinkState.UP
            self.identity = ack
            self.problem = self._refusal = ""
            self._last_rx_seq = frame.seq
            self._telemetry_at = self._next_ping = self._next_stats = now
            minor = "" if ack.minor == MINOR else f", minor {min(ack.minor, MINOR)} is used"
            self._events.append(
                LinkEvent(
                    LinkEventKind.UP,
                    f"{self._name} PLC: firmware {ack.version_major}.{ack.version_minor}."
                    f"{ack.version_patch}, boot {ack.boot_count}, last reset: "
                    f"{_reset_cause_name(ack.reset_cause)}{minor}",
                )
            )

    def _refuse(self, problem: str, now: float) -> None:
        self.state = LinkState.REFUSED
        self.problem = self._refusal = problem
        self._refused_at = now
        self._frames.clear()
        self._events.append(LinkEvent(LinkEventKind.REFUSED, problem))

    def _rebooted(self, now: float, how: str) -> None:
        self.counters.reboots += 1
        self._events.append(LinkEvent(LinkEventKind.REBOOTED, f"{self._name} PLC rebooted: {how}"))
        self.problem = "the PLC rebooted"
        self._frames.clear()
        self.state = LinkState.GREETING
        self._start_greeting(now)

    def _handle_state(self, state: State, now: float) -> None:
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
        return f"{self._name} PLC: {state_name(old)} to {state_name(new)}{faults}"


def state_name(state: int) -> str:
    """Name of a PLC state, also of one that a newer minor version added."""
    try:
        return PlcState(state).name
    except ValueError:
        return f"STATE_{state}"


def _result_of(result: int) -> Result:
    try:
        return Result(result)
    except ValueError:  # an unknown refusal of a newer minor version is a refusal
        return Result.WRONG_STATE


def _reset_cause_name(cause: int) -> str:
    try:
        return ResetCause(cause).name.lower().replace("_", "-")
    except ValueError:
        return f"cause {cause}"
