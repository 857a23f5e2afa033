"""Operations of the PLC: CTRL and SETUP, resent until they are acknowledged (section 4).

Section numbers are those of docs/protocol.md. Times are seconds on one monotonic host clock.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from tricycle_bridge.protocol.messages import Ack, Op, Result

RESEND_PERIOD = 0.05
"""Time until an operation is sent again [s]."""

RESENDS = 3
"""How often an operation is sent again until it is given up."""


@dataclass(frozen=True)
class OperationOutcome:
    """Outcome of an operation.

    Attributes
    ----------
    op : Op
        Operation that ended.
    result : Result or None
        Result in the ACK; None if none came.
    """

    op: Op
    result: Result | None


@dataclass
class _Pending:
    op: Op
    number: int  # of the operation, the same in its resends
    sent_at: float
    seqs: list[int]  # of the first sending and the resends
    result: Result | None = None  # so far


class OperationQueue:
    """Operations for one PLC, sent one after the other.

    Parameters
    ----------
    send : callable
        Sends an operation with its number (modulo 256) and returns the sequence number of the
        frame.
    """

    def __init__(self, send: Callable[[Op, int], int]) -> None:
        self._send = send
        self._number = 0  # of the next operation; goes on in the next session
        self._pending: _Pending | None = None
        self._waiting: deque[Op] = deque()

    def add(self, op: Op, now: float) -> None:
        """Send an operation after those still unanswered; ESTOP and DISARM replace them.

        Parameters
        ----------
        op : Op
            Operation, e.g. ARM.
        now : float
            Present time [s].
        """
        if op in (Op.ESTOP, Op.DISARM):
            self.clear()
        self._waiting.append(op)
        self._send_next(now)

    def poll(self, now: float) -> OperationOutcome | None:
        """Send what is due at a time [s]; return the operation that is given up, if any."""
        if self._pending is None:
            self._send_next(now)
        elif now - self._pending.sent_at >= RESEND_PERIOD:
            if len(self._pending.seqs) > RESENDS:
                return self._finish(self._pending.result)
            self._pending.sent_at = now
            self._pending.seqs.append(self._send(self._pending.op, self._pending.number))
        return None

    def acknowledge(self, ack: Ack, now: float) -> OperationOutcome | None:
        """Take an ACK; return the operation that it ends, or None if it answers an older one.

        An operation whose echo was too old is sent again like one without an answer.

        Parameters
        ----------
        ack : Ack
            Acknowledgement of the PLC.
        now : float
            Present time [s].
        """
        pending = self._pending
        if pending is None or ack.op != pending.op or ack.ctrl_seq not in pending.seqs:
            return None
        if (result := _result(ack)) is Result.STALE:
            pending.result = result
            return None
        outcome = self._finish(result)
        self._send_next(now)
        return outcome

    @property
    def busy(self) -> bool:
        """Whether an operation waits, or is sent and not answered."""
        return self._pending is not None or bool(self._waiting)

    def includes(self, op: Op) -> bool:
        """Whether an operation waits, or is sent and not answered."""
        return op in self._waiting or (self._pending is not None and self._pending.op == op)

    def clear(self) -> None:
        """Forget all operations."""
        self._pending = None
        self._waiting.clear()

    def _send_next(self, now: float) -> None:
        if self._pending is None and self._waiting:
            op, number = self._waiting.popleft(), self._number
            self._number = (number + 1) & 0xFF
            self._pending = _Pending(op, number, now, [self._send(op, number)])

    def _finish(self, result: Result | None) -> OperationOutcome | None:
        pending, self._pending = self._pending, None
        return None if pending is None else OperationOutcome(pending.op, result)


def _result(ack: Ack) -> Result:
    try:
        return Result(ack.result)
    except ValueError:  # a result that a newer minor version added is a refusal
        return Result.WRONG_STATE
