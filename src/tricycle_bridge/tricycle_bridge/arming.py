"""Arming both boards: what must hold before, and the sequence of operations.

Times are seconds on the bridge's clock.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from tricycle_bridge.commands.command_stream import VehicleCommand
from tricycle_bridge.plc_link.link import DEGRADED_AGE, PlcLink
from tricycle_bridge.plc_link.operations import OperationOutcome
from tricycle_bridge.protocol.boards import ADC_HIGH, ADC_LOW
from tricycle_bridge.protocol.limits import ARMING_COMMANDS, ARMING_SPEED
from tricycle_bridge.protocol.messages import (
    Board,
    DriveState,
    Fault,
    Op,
    PlcState,
    Result,
    StateFlag,
    SteerState,
)
from tricycle_bridge.protocol.readable import state_and_faults
from tricycle_bridge.protocol.units import SPEED_UNIT, VOLTAGE_UNIT
from tricycle_bridge.settings import UNCHECKED_SUPPLY

ARMING_PATIENCE = 2.0
"""Time for the whole sequence [s]."""

Links = Mapping[Board, PlcLink]


class ArmingOutcome(NamedTuple):
    """Outcome of the operator's request to arm.

    Attributes
    ----------
    armed : bool
        Whether both boards are armed.
    text : str
        Text for the operator.
    """

    armed: bool
    text: str


def arming_refusal(
    links: Links, command: VehicleCommand | None, now: float, *, enabled: bool
) -> str | None:
    """Return the first precondition of arming that does not hold; None if all do.

    Parameters
    ----------
    links : mapping of Board to PlcLink
        Link to each board.
    command : VehicleCommand or None
        Newest command of the commander; None without a fresh one.
    now : float
        Present time [s].
    enabled : bool
        Whether commands are sent with the enable flag already.
    """
    for board, link in links.items():
        if reason := _link_refusal(link, now, enabled=enabled):
            return f"{board.plc_name}: {reason}"
    for link in links.values():
        if reason := supply_problem(link) or _setup_refusal(link):
            return reason
    steer = links[Board.STEER].telemetry
    if isinstance(steer, SteerState) and not ADC_LOW <= steer.adc <= ADC_HIGH:
        return (
            f"steer PLC: its potentiometer is at {steer.adc} counts, must be {ADC_LOW} to "
            f"{ADC_HIGH}: a broken wire"
        )
    speed = measured_speed(links[Board.DRIVE], now)
    if speed is not None and abs(speed) >= ARMING_SPEED:
        return f"the vehicle moves at {speed:.2f} m/s"
    return waiting_speed(command)


def waiting_speed(command: VehicleCommand | None) -> str | None:
    """Return that a command asks for a speed, which an armed vehicle would have at once; else None.

    Parameters
    ----------
    command : VehicleCommand or None
        Newest command of the commander; None without a fresh one.
    """
    if command is None or command.speed == 0.0:
        return None
    return f"commanded speed is {command.speed:.2f} m/s, must be 0"


def _link_refusal(link: PlcLink, now: float, *, enabled: bool) -> str | None:
    if not link.up or link.telemetry is None:
        return link.down_reason
    if link.telemetry_age(now) > DEGRADED_AGE:
        return f"telemetry {link.telemetry_age(now):.2f} s old"
    if link.telemetry.flags & StateFlag.ESTOP_PRESSED:
        return "hardware e-stop pressed"
    state = link.telemetry.state
    if state == PlcState.STOPPING or (state == PlcState.ARMED and not enabled):
        return "still stopping"
    if link.telemetry.flags & StateFlag.HOLDING and state != PlcState.ARMED:
        return "still holds its angle until the vehicle is measured at rest"
    return None


def _setup_refusal(link: PlcLink) -> str | None:
    """A board in ESTOP or FAULT takes its set-up only after CLEAR, which arming sends."""
    if link.set_up or (link.plc_state != PlcState.SAFE and not link.setup_out_of_range):
        return None
    return link.problem or f"{link.board.plc_name} is not set up yet"


def supply_problem(link: PlcLink) -> str | None:
    """Return how the supply of a board is outside its thresholds; None if it is inside.

    Parameters
    ----------
    link : PlcLink
        Link to the board.
    """
    if link.telemetry is None or link.limits is None:
        return None
    supply = link.telemetry.supply * VOLTAGE_UNIT
    low, high = (v * VOLTAGE_UNIT for v in (link.limits.supply_low, link.limits.supply_high))
    if low <= supply and (supply <= high or not high) and not link.telemetry.faults & Fault.SUPPLY:
        return None
    thresholds = [f"at least {low:.1f} V"] if low else []
    thresholds += [f"at most {high:.1f} V"] if 0.0 < high < UNCHECKED_SUPPLY else []
    must = f", must be {' and '.join(thresholds)}" if thresholds else ""
    return f"{link.board.plc_name}: supply is {supply:.1f} V{must}"


def fresh_state(drive: PlcLink, now: float) -> DriveState | None:
    """Return the telemetry of the drive PLC; None if it is not fresh.

    Parameters
    ----------
    drive : PlcLink
        Link to the drive PLC.
    now : float
        Present time [s].
    """
    state = drive.telemetry
    if not isinstance(state, DriveState) or drive.telemetry_age(now) > DEGRADED_AGE:
        return None
    return state


def measured_speed(drive: PlcLink, now: float) -> float | None:
    """Return the speed that the drive PLC measures [m/s]; None without fresh telemetry.

    Parameters
    ----------
    drive : PlcLink
        Link to the drive PLC.
    now : float
        Present time [s].
    """
    state = fresh_state(drive, now)
    return None if state is None else state.speed * SPEED_UNIT


def board_condition(link: PlcLink) -> str:
    """Return the state of a board for a person, e.g. ``steer PLC is FAULT (SENSOR)``.

    Parameters
    ----------
    link : PlcLink
        Link to the board.
    """
    if link.telemetry is None:
        return f"{link.board.plc_name} is lost"
    faults = link.telemetry.faults & ~Fault.LIMIT
    return f"{link.board.plc_name} is {state_and_faults(link.telemetry.state, faults)}"


class ArmingSequence:
    """One request of the operator: CLEAR to both boards, a row of enabled commands, ARM to both.

    A board that was in ESTOP or FAULT is set up between CLEAR and ARM. A board that refuses ARM for
    its preconditions is sent a row of commands and ARM again, as long as there is time: where a
    computer pauses, commands come late and the board counts fewer of them than were sent.

    The owner passes on what happens, and after each call looks at `failure` and `complete`.

    Parameters
    ----------
    links : mapping of Board to PlcLink
        Both links; CLEAR is sent at once.
    now : float
        Present time [s].

    Attributes
    ----------
    failure : str or None
        Why the sequence failed; None while it has not.
    complete : bool
        Whether both boards are armed.
    """

    def __init__(self, links: Links, now: float) -> None:
        self.failure: str | None = None
        self.complete = False
        self._links = links
        self._deadline = now + ARMING_PATIENCE
        self._cleared: set[Board] = set()
        self._armed: set[Board] = set()
        self._arm_sent = False
        self._refusals: dict[Board, str] = {}  # of ARM, which may be accepted yet
        self._commands = 0
        self._operate(Op.CLEAR, now)

    def count_command(self) -> None:
        """Note that an enabled command was sent to both boards."""
        # a board that takes its set-up begins to count anew
        set_up = all(link.set_up for link in self._links.values())
        self._commands = self._commands + 1 if set_up else 0

    def take_outcome(self, board: Board, outcome: OperationOutcome) -> None:
        """Take a board's answer to CLEAR or ARM.

        Parameters
        ----------
        board : Board
            Board that the operation was sent to.
        outcome : OperationOutcome
            Result in its answer, or that there was no answer.
        """
        if outcome.result is None:
            self.failure = f"{board.plc_name} did not answer {outcome.op.name}"
        elif outcome.result is not Result.OK:
            why = outcome.result.name.lower().replace("_", " ")
            condition = board_condition(self._links[board])
            refusal = f"{condition} and refused {outcome.op.name}: {why}"
            if outcome.op is Op.ARM and outcome.result is Result.PRECONDITIONS:
                self._refusals[board] = refusal
                self._arm_sent, self._commands = False, 0
            else:
                self.failure = refusal
        elif outcome.op is Op.CLEAR:
            self._cleared.add(board)
        else:
            self._armed.add(board)
            self._refusals.pop(board, None)

    def advance(self, now: float) -> None:
        """Do the next step if it is due at a time [s]."""
        if now > self._deadline:
            waiting = [link for link in self._links.values() if not link.set_up]
            self.failure = next(iter(self._refusals.values()), "the PLCs did not arm in time")
            if waiting and not self._arm_sent:
                self.failure = _setup_refusal(waiting[0]) or board_condition(waiting[0])
        elif not self._arm_sent:
            # one command more than needed, in case the last one before ARM is damaged
            if (
                len(self._cleared) == len(self._links)
                and self._commands > ARMING_COMMANDS
                and all(link.set_up for link in self._links.values())
            ):
                self._arm_sent = True
                self._operate(Op.ARM, now)
        elif len(self._armed) == len(self._links):
            self._check_states()

    def _check_states(self) -> None:
        """Wait for telemetry in ARMED; a board may have found a fault after it armed."""
        for link in self._links.values():
            if link.plc_state not in (PlcState.SAFE, PlcState.ARMED):
                self.failure = board_condition(link)
                return
        self.complete = all(link.plc_state == PlcState.ARMED for link in self._links.values())

    def _operate(self, op: Op, now: float) -> None:
        for link in self._links.values():
            link.operate(op, now)
