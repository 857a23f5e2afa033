"""Arming both boards: what must hold before, and the sequence of operations.

Times are seconds on the host's (ROS) clock.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from tricycle_bridge.command_stream import VehicleCommand
from tricycle_bridge.link import DEGRADED_AGE, PlcLink
from tricycle_bridge.operations import OperationOutcome
from tricycle_bridge.protocol.limits import ARMING_COMMANDS
from tricycle_bridge.protocol.messages import Board, Fault, Op, PlcState, Result, StateFlag
from tricycle_bridge.protocol.readable import fault_names, state_name

ARMING_PATIENCE = 2.0
"""Time for the whole sequence [s]."""

Links = Mapping[Board, PlcLink]


class ArmingOutcome(NamedTuple):
    """How the operator's request to arm ended.

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
        Both links.
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
    if command is None:
        return "no command stream"
    if command.speed != 0.0:
        return f"commanded speed is {command.speed:.2f} m/s, must be 0"
    return None


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
    return None


def board_condition(link: PlcLink) -> str:
    """Return the state of a board for a person, e.g. ``steer PLC is FAULT (SENSOR)``.

    Parameters
    ----------
    link : PlcLink
        Link to the board.
    """
    if link.telemetry is None:
        return f"{link.board.plc_name} is lost"
    faults = fault_names(link.telemetry.faults & ~Fault.LIMIT)
    state = state_name(link.telemetry.state)
    return f"{link.board.plc_name} is {state}" + (f" ({faults})" if faults else "")


class ArmingSequence:
    """One request of the operator: CLEAR to both boards, a row of enabled commands, ARM to both.

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
        self._commands = 0
        self._operate(Op.CLEAR, now)

    def count_command(self) -> None:
        """Note that an enabled command was sent to both boards."""
        self._commands += 1

    def take_outcome(self, board: Board, outcome: OperationOutcome) -> None:
        """Take a board's answer to CLEAR or ARM.

        Parameters
        ----------
        board : Board
            Board that was to answer.
        outcome : OperationOutcome
            Its answer, or that there was none.
        """
        if outcome.result is None:
            self.failure = f"{board.plc_name} did not answer {outcome.op.name}"
        elif outcome.result is not Result.OK:
            why = outcome.result.name.lower().replace("_", " ")
            condition = board_condition(self._links[board])
            self.failure = f"{condition} and refused {outcome.op.name}: {why}"
        elif outcome.op is Op.CLEAR:
            self._cleared.add(board)
        else:
            self._armed.add(board)

    def advance(self, now: float, *, commanded: bool) -> None:
        """Do the next step if it is due.

        Parameters
        ----------
        now : float
            Present time [s].
        commanded : bool
            Whether the commander's newest command is fresh.
        """
        if not commanded:
            self.failure = "no command stream"
        elif now > self._deadline:
            self.failure = "the PLCs did not arm in time"
        elif not self._arm_sent:
            # one command more than needed, in case the last one before ARM is damaged
            if len(self._cleared) == len(self._links) and self._commands > ARMING_COMMANDS:
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
