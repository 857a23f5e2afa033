"""The bridge between vehicle commands in SI units and two by-wire links; no port, no ROS inside.

`Bridge` decides who may move the vehicle: arming, freshness of its input, what one lost board does
to the other, and why a request is refused. Times are seconds on the host's (ROS) clock.
"""

from __future__ import annotations

import enum
import itertools
import math
import random
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from tricycle_bridge.link import (
    DEGRADED_AGE,
    Command,
    Controlled,
    LinkEvent,
    LinkEventKind,
    LinkState,
    PlcLink,
    state_name,
)
from tricycle_bridge.protocol.messages import (
    ANGLE_UNIT,
    ARMING_COMMANDS,
    MAX_ACCELERATION,
    MAX_SPEED,
    MAX_STEERING_ANGLE,
    MAX_STEERING_RATE,
    SPEED_UNIT,
    STEER_RATE_UNIT,
    Board,
    CommandFlag,
    DriveCommand,
    DriveLimits,
    DriveState,
    Fault,
    Gear,
    Op,
    PlcState,
    Result,
    StateFlag,
    SteerCommand,
    SteerState,
    fault_names,
)
from tricycle_core.errors import LinkError
from tricycle_core.joints import REAR_WHEEL_JOINT, STEERING_JOINT
from tricycle_core.quantities import TICK

INPUT_AGE = 0.1  # s; older input moves nothing
# s between commands on average. The protocol's most is 100 Hz; were this just that, the jitter of a
# commander at 100 Hz would add up to a lag that never drains.
FASTEST_PERIOD = 0.0095
ARMING_PATIENCE = 2.0  # s for all of an arming
_JITTER = 1e-3  # s by which a command may be early: clocks tick, they do not flow
BOARDS = (Board.STEER, Board.DRIVE)


@dataclass(frozen=True)
class BridgeSettings:
    """What the bridge knows of the vehicle.

    Raises
    ------
    LinkError
        A value is outside what protocol and PLCs allow.
    """

    command_rate: float = 50.0  # Hz, of repeats between the commander's messages
    tyre_radius: float = 0.335  # m
    max_steering_rate: float = 2.0  # rad/s of the steering motor
    max_acceleration: float = 1.0  # m/s^2

    def __post_init__(self) -> None:
        for name, low, high in (
            ("command_rate", 20.0, 100.0),
            ("tyre_radius", 0.05, 2.0),
            ("max_steering_rate", STEER_RATE_UNIT, MAX_STEERING_RATE),
            ("max_acceleration", SPEED_UNIT, MAX_ACCELERATION),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise LinkError(f"{name} = {value:g} is outside {low:g}..{high:g}")


@dataclass(frozen=True)
class Setpoint:
    """What a commander wants the vehicle to do.

    Raises
    ------
    LinkError
        A value is not finite.
    """

    steering_motor_angle: float  # rad, left positive
    speed: float  # m/s, forward positive

    def __post_init__(self) -> None:
        for name in ("steering_motor_angle", "speed"):
            if not math.isfinite(getattr(self, name)):
                raise LinkError(f"{name} is {getattr(self, name)}: must be a finite number")


class Source(enum.Enum):
    """Who commands; the first one wins while it is fresh."""

    JOINT_COMMANDS = "joint_commands"
    CMD_VEL = "cmd_vel"


@dataclass(frozen=True)
class JointReading:
    """Measured state of one joint."""

    name: str
    position: float  # rad
    velocity: float  # rad/s


_Measured = tuple[float, JointReading]  # s, host clock


@dataclass(frozen=True)
class JointReadings:
    """Joints measured together."""

    stamp: float  # s, host clock, time of measurement
    joints: tuple[JointReading, ...]


@dataclass
class BridgeCounters:
    """What happened to the commanders' messages."""

    accepted: int = 0
    stale: int = 0  # older than INPUT_AGE on arrival
    refused: int = 0  # not finite, joints missing, or a second commander


@dataclass
class _Input:
    setpoint: Setpoint
    stamp: float
    source: Source


@dataclass
class _Arming:
    """A request of the operator on its way."""

    done: Callable[[bool, str], None]
    deadline: float
    cleared: set[Board] = field(default_factory=set)
    armed: set[Board] = field(default_factory=set)
    arm_sent: bool = False
    commands: int = 0  # sent since the request


class Bridge:
    """Two links driven as one vehicle.

    Feed it with `set_command`, `receive`, `poll`; write what `take_frames` returns; publish what
    `take_readings` returns; log what `take_messages` returns.

    Parameters
    ----------
    settings
        Vehicle and rates.
    rng
        Source of sessions and nonces.
    boot_wait
        Seconds of silence after opening a port.
    """

    def __init__(
        self, settings: BridgeSettings, *, rng: random.Random, boot_wait: float = 0.0
    ) -> None:
        self.settings = settings
        self.links = {board: PlcLink(board, rng=rng, boot_wait=boot_wait) for board in BOARDS}
        self.counters = BridgeCounters()
        self.active = False  # whether commands are forwarded (lifecycle)
        self._enabled = False  # operator wants the vehicle armed
        self._estopped = False  # operator's e-stop, until the next arm request
        self._input: _Input | None = None
        self._sent: tuple[_Input, bool] | None = None
        self._sent_at = -math.inf
        self._allowed_at = -math.inf
        self._stop_sent_at = -math.inf
        self._gear = Gear.DRIVE
        self._arming: _Arming | None = None
        self._messages: list[tuple[bool, str]] = []  # (is a warning, text)
        self._readings: list[JointReadings] = []
        self._unpaired: dict[Board, deque[_Measured]] = {b: deque() for b in BOARDS}

    # ---- what the owner asks ----

    @property
    def armed(self) -> bool:
        """Whether both boards said ARMED in their newest telemetry."""
        return all(self._plc_state(board) == PlcState.ARMED for board in BOARDS)

    def take_messages(self) -> list[tuple[bool, str]]:
        """Return what a person should read, as (is a warning, text)."""
        messages, self._messages = self._messages, []
        return messages

    def take_readings(self) -> list[JointReadings]:
        """Return the joints measured since the last call."""
        readings, self._readings = self._readings, []
        return readings

    def take_frames(self) -> dict[Board, list[bytes]]:
        """Return the frames to write, by board."""
        return {board: link.take_frames() for board, link in self.links.items()}

    def refusal(self, now: float) -> str:
        """Why the vehicle cannot be armed now; empty when it can."""
        if not self.active:
            return "the bridge is not active"
        for board, link in self.links.items():
            if not link.up or link.telemetry is None:
                return f"{_name(board)} PLC: {link.trouble}"
            if link.telemetry_age(now) > DEGRADED_AGE:
                return f"{_name(board)} PLC: telemetry {link.telemetry_age(now):.2f} s old"
            if link.telemetry.flags & StateFlag.ESTOP_PRESSED:
                return f"{_name(board)} PLC: hardware e-stop pressed"
            state = link.telemetry.state
            if state == PlcState.STOPPING or (state == PlcState.ARMED and not self._enabled):
                return f"{_name(board)} PLC: still stopping"
        if (command := self._fresh_input(now)) is None:
            return "no command stream"
        if command.setpoint.speed != 0.0:
            return f"commanded speed is {command.setpoint.speed:.2f} m/s, must be 0"
        return ""

    # ---- what the owner does ----

    def opened(self, board: Board, now: float) -> None:
        """Begin on a port that was just opened."""
        self.links[board].opened(now)

    def closed(self, board: Board, reason: str) -> None:
        """Note that a port is gone, or cannot be opened."""
        link = self.links[board]
        was = link.problem
        self._take_events(board, link.closed(reason))
        if reason != was:
            self._warn(f"{_name(board)} PLC: {reason}")

    def set_command(self, setpoint: Setpoint, *, stamp: float, now: float, source: Source) -> str:
        """Take a commander's message and forward it where it is due.

        Parameters
        ----------
        setpoint
            What is wanted; values outside the vehicle's limits are limited.
        stamp
            When it was wanted, s on the host's clock.
        now
            Time of arrival.
        source
            Who wants it.

        Returns
        -------
        str
            Why it was refused; empty when it was taken.
        """
        age = now - stamp
        if abs(age) > INPUT_AGE:
            self.counters.stale += 1
            return (
                f"{source.value} stamped {age:.2f} s ago, must be within {INPUT_AGE} s"
                if stamp
                else f"{source.value} has no time stamp"
            )
        current = self._fresh_input(now)
        if (
            current is not None
            and current.source is Source.JOINT_COMMANDS
            and source is Source.CMD_VEL
        ):
            self.counters.refused += 1
            return f"{source.value} ignored while {current.source.value} are coming"
        self.counters.accepted += 1
        self._input = _Input(setpoint, min(stamp, now), source)
        self._send_commands(now)
        return ""

    def receive(self, board: Board, data: bytes, now: float) -> None:
        """Take bytes from a port."""
        self._take_events(board, self.links[board].receive(data, now))

    def poll(self, now: float) -> None:
        """Do what is due; call it after every `receive` and at least every 50 ms."""
        for board, link in self.links.items():
            self._take_events(board, link.poll(now))
        self._check_boards_agree()
        self._send_commands(now)
        self._send_stop(now)
        self._advance_arming(now)

    def arm(self, now: float, done: Callable[[bool, str], None]) -> None:
        """Have both boards clear their faults and arm; `done(success, text)` tells the outcome."""
        if self._arming is not None:
            done(False, "arming is under way")
        elif self.armed and self._enabled:
            done(True, "already armed")
        elif reason := self.refusal(now):
            done(False, f"not armed: {reason}")
        else:
            self._enabled = True
            self._estopped = False
            self._arming = _Arming(done, now + ARMING_PATIENCE)
            for link in self.links.values():
                link.control(Op.CLEAR, now)

    def disarm(self, now: float) -> str:
        """Take the vehicle's drive away at once (outputs off, brake on)."""
        self._withdraw("disarmed by the operator")
        return self._operate_all(Op.DISARM, now)

    def emergency_stop(self, now: float) -> str:
        """Latch ESTOP on both boards: by CTRL and by the flag of every command until ARM."""
        self._withdraw("emergency stop")
        self._estopped = True
        return self._operate_all(Op.ESTOP, now)

    def restart_links(self, now: float, reason: str) -> None:
        """Shake hands anew on the open ports, after the host's clock jumped back."""
        self._input = None
        self._sent_at = self._allowed_at = -math.inf
        for board, link in self.links.items():
            self._unpaired[board].clear()
            if link.state is not LinkState.CLOSED:
                self.closed(board, reason)
                self.opened(board, now)

    def stop(self, reason: str) -> None:
        """Let both boards come to rest (no fault) and wait for the operator's next ARM."""
        self._withdraw(reason)

    # ---- commands ----

    def _fresh_input(self, now: float) -> _Input | None:
        return (
            self._input
            if self._input is not None and now - self._input.stamp <= INPUT_AGE + _JITTER
            else None
        )

    def _send_commands(self, now: float) -> None:
        """Forward a new input at once (at most 100 Hz), the same again at `command_rate`."""
        command = self._fresh_input(now) if self.active else None
        if command is None:
            return
        if self._sent != (command, self._enabled):
            if now < self._allowed_at - _JITTER:
                return
            # one message that came late does not hold up the next one
            self._allowed_at = max(self._allowed_at, now - FASTEST_PERIOD) + FASTEST_PERIOD
        elif now < self._sent_at + 1.0 / self.settings.command_rate - _JITTER:
            return
        flags = (CommandFlag.ENABLE if self._enabled else 0) | (
            CommandFlag.ESTOP if self._estopped else 0
        )
        sent = [
            self.links[Board.STEER].send_command(self._steer_command(command.setpoint, flags)),
            self.links[Board.DRIVE].send_command(self._drive_command(command.setpoint, flags)),
        ]
        self._sent, self._sent_at = (command, self._enabled), now
        if self._arming is not None and all(sent):
            self._arming.commands += 1

    def _steer_command(self, setpoint: Setpoint, flags: int) -> SteerCommand:
        angle = min(max(setpoint.steering_motor_angle, -MAX_STEERING_ANGLE), MAX_STEERING_ANGLE)
        rate = round(self.settings.max_steering_rate / STEER_RATE_UNIT)
        return SteerCommand(flags, 0, round(angle / ANGLE_UNIT), rate, 0)

    def _drive_command(self, setpoint: Setpoint, flags: int) -> DriveCommand:
        speed = round(min(abs(setpoint.speed), MAX_SPEED) / SPEED_UNIT)
        if speed:  # at 0 the gear stays
            self._gear = Gear.DRIVE if setpoint.speed > 0 else Gear.REVERSE
        acceleration = round(self.settings.max_acceleration / SPEED_UNIT)
        return DriveCommand(flags, self._gear, speed, acceleration, 0, 0, 0)

    def _send_stop(self, now: float) -> None:
        """Tell a board that is armed against the operator's will to stop (enable = 0)."""
        if self._enabled or now - self._stop_sent_at < 1.0 / self.settings.command_rate - _JITTER:
            return
        for board, link in self.links.items():
            if self._plc_state(board) == PlcState.ARMED and link.telemetry is not None:
                link.send_command(_hold(link.telemetry))
                self._stop_sent_at = now

    def _withdraw(self, reason: str) -> None:
        """Nothing is enabled any more until the operator's next ARM."""
        if self._enabled:
            self._warn(f"stopped: {reason}")
        self._enabled = False
        self._stop_sent_at = -math.inf
        self._finish_arming(False, f"not armed: {reason}")

    def _operate_all(self, op: Op, now: float) -> str:
        unreached = [_name(board) for board, link in self.links.items() if not link.up]
        for link in self.links.values():
            link.control(op, now)
        missing = f"; no link to the {' and '.join(unreached)} PLC" if unreached else ""
        return f"{op.name} sent{missing}"

    # ---- boards ----

    def _plc_state(self, board: Board) -> int | None:
        telemetry = self.links[board].telemetry
        return None if telemetry is None else telemetry.state

    def _check_boards_agree(self) -> None:
        """Stop the other board when one that was armed no longer is."""
        if not self._enabled or self._arming is not None:
            return
        for board in BOARDS:
            if self._plc_state(board) != PlcState.ARMED:
                self._withdraw(self._describe(board))
                return

    def _describe(self, board: Board) -> str:
        """What a board says of itself."""
        telemetry = self.links[board].telemetry
        if telemetry is None:
            return f"{_name(board)} PLC is lost"
        faults = fault_names(telemetry.faults & ~Fault.LIMIT)
        state = state_name(telemetry.state)
        return f"{_name(board)} PLC is {state}" + (f" ({faults})" if faults else "")

    def _take_events(self, board: Board, events: list[LinkEvent]) -> None:
        for event in events:
            match event.kind:
                case LinkEventKind.TELEMETRY:
                    if event.state is not None:
                        self._pair_reading(board, event.stamp, event.state)
                case LinkEventKind.CONTROLLED:
                    if event.controlled is not None:
                        self._controlled(board, event.controlled)
                case LinkEventKind.UP | LinkEventKind.STATE_CHANGED:
                    self._messages.append((False, event.text))
                case LinkEventKind.SILENT | LinkEventKind.REFUSED:
                    self._warn(f"{_name(board)} PLC: {event.text}")
                case LinkEventKind.LOST | LinkEventKind.REBOOTED:
                    self._warn(event.text)
                    self._withdraw(event.text)
        self._check_boards_agree()

    def _warn(self, text: str) -> None:
        self._messages.append((True, text))

    # ---- arming: CLEAR both, a row of enabled commands, ARM both ----

    def _controlled(self, board: Board, outcome: Controlled) -> None:
        arming = self._arming
        if arming is None or outcome.op not in (Op.CLEAR, Op.ARM):
            if outcome.result not in (Result.OK, None):
                self._warn(f"{_name(board)} PLC refused {outcome.op.name}: {outcome.result.name}")
            return
        if outcome.result is None:
            self._withdraw(f"{_name(board)} PLC did not answer {outcome.op.name}")
        elif outcome.result is not Result.OK:
            why = outcome.result.name.lower().replace("_", " ")
            self._withdraw(f"{self._describe(board)} and refused {outcome.op.name}: {why}")
        elif outcome.op is Op.CLEAR:
            arming.cleared.add(board)
        else:
            arming.armed.add(board)

    def _advance_arming(self, now: float) -> None:
        arming = self._arming
        if arming is None:
            return
        if self._fresh_input(now) is None:
            self._withdraw("no command stream")
        elif now > arming.deadline:
            self._withdraw("the PLCs did not arm in time")
        elif not arming.arm_sent:
            # one more command than needed, because ARM must not overtake a damaged one
            if len(arming.cleared) == len(BOARDS) and arming.commands > ARMING_COMMANDS:
                arming.arm_sent = True
                for link in self.links.values():
                    link.control(Op.ARM, now)
        elif len(arming.armed) == len(BOARDS):
            for board in BOARDS:
                if self._plc_state(board) not in (PlcState.SAFE, PlcState.ARMED):
                    self._withdraw(self._describe(board))  # armed, and found a fault
                    return
            if self.armed:
                self._finish_arming(True, "armed")

    def _finish_arming(self, success: bool, text: str) -> None:
        arming, self._arming = self._arming, None
        if arming is not None:
            arming.done(success, text)

    # ---- joint states ----

    def _pair_reading(self, board: Board, stamp: float, state: SteerState | DriveState) -> None:
        """Join the boards' readings of one tick; a board whose partner is away reports alone.

        On a busy machine a port gives many ticks at once, so a reading waits for its partner's
        for as long as the partner's link is up.
        """
        reading = self._reading(state)
        if reading is None:
            return
        other = Board.DRIVE if board is Board.STEER else Board.STEER
        own, partners = self._unpaired[board], self._unpaired[other]
        while partners and not _may_be_of_one_tick(partners, stamp):
            self._report(*partners.popleft())
        if not partners:
            own.append((stamp, reading))
            while own and not self.links[other].up:
                self._report(*own.popleft())
        elif partners[0][0] >= stamp + TICK:
            self._report(stamp, reading)
        else:
            measured, partner = partners.popleft()
            self._report(stamp, reading, _at(partner, measured, stamp))

    def _report(self, stamp: float, *joints: JointReading) -> None:
        ordered = sorted(joints, key=lambda joint: joint.name, reverse=True)
        self._readings.append(JointReadings(stamp, tuple(ordered)))

    def _reading(self, state: SteerState | DriveState) -> JointReading | None:
        if isinstance(state, SteerState):
            return JointReading(
                STEERING_JOINT, state.angle * ANGLE_UNIT, state.rate * STEER_RATE_UNIT
            )
        limits = self.links[Board.DRIVE].limits
        if not isinstance(limits, DriveLimits):
            return None  # not told yet how far a hall pulse is
        radius = self.settings.tyre_radius
        return JointReading(
            REAR_WHEEL_JOINT,
            state.hall_count * limits.pulse * 1e-6 / radius,
            state.speed * SPEED_UNIT / radius,
        )


def _may_be_of_one_tick(waiting: deque[_Measured], stamp: float) -> bool:
    """Whether the oldest of these is no tick older than `stamp`, and the next no nearer to it."""
    first, *later = (measured for measured, _ in itertools.islice(waiting, 2))
    return first > stamp - TICK and all(abs(first - stamp) <= abs(m - stamp) for m in later)


def _at(joint: JointReading, measured: float, stamp: float) -> JointReading:
    """Carry a reading over the few milliseconds to another board's time of measurement."""
    return JointReading(
        joint.name, joint.position + joint.velocity * (stamp - measured), joint.velocity
    )


def _hold(telemetry: SteerState | DriveState) -> Command:
    """Return the command that stops a board: enable = 0, everything else as it is."""
    if isinstance(telemetry, SteerState):
        return SteerCommand(0, 0, telemetry.setpoint, 0, 0)
    return DriveCommand(0, telemetry.gear, 0, 0, 0, 0, 0)


def _name(board: Board) -> str:
    return board.name.lower()
