"""Operations are sent one at a time until each is acknowledged."""

import pytest

from tricycle_bridge.plc_link.operations import OperationOutcome, OperationQueue
from tricycle_bridge.protocol.messages import Ack, Op, Result


class Sent:
    """What was sent; the sequence number of a frame is its place."""

    def __init__(self):
        self.ops = []
        self.numbers = []

    def __call__(self, op, number):
        self.ops.append(op)
        self.numbers.append(number)
        return len(self.ops) - 1


@pytest.fixture
def sent():
    return Sent()


@pytest.fixture
def queue(sent):
    return OperationQueue(sent)


def test_an_operation_is_resent_three_times_then_given_up(queue, sent):
    queue.add(Op.CLEAR, 0.0)
    outcomes = [outcome for k in range(1, 100) if (outcome := queue.poll(k * 0.01))]
    assert sent.ops == [Op.CLEAR] * 4
    assert outcomes == [OperationOutcome(Op.CLEAR, None)]


@pytest.mark.parametrize("seq", [0, 1])
def test_the_answer_to_any_of_its_frames_ends_an_operation(queue, sent, seq):
    queue.add(Op.CLEAR, 0.0)
    queue.add(Op.ARM, 0.0)
    assert sent.ops == [Op.CLEAR]
    queue.poll(0.05)
    outcome = queue.acknowledge(Ack(Op.CLEAR, seq, Result.WRONG_STATE, 0), 0.06)
    assert outcome == OperationOutcome(Op.CLEAR, Result.WRONG_STATE)
    assert sent.ops == [Op.CLEAR, Op.CLEAR, Op.ARM]


@pytest.mark.parametrize("ack", [Ack(Op.CLEAR, 9, 0, 0), Ack(Op.ARM, 0, 0, 0)])
def test_an_answer_to_something_else_is_ignored(queue, ack):
    queue.add(Op.CLEAR, 0.0)
    assert queue.acknowledge(ack, 0.01) is None
    assert queue.acknowledge(Ack(Op.CLEAR, 0, 0, 0), 0.02) == OperationOutcome(Op.CLEAR, Result.OK)


@pytest.mark.parametrize("urgent", [Op.ESTOP, Op.DISARM])
def test_estop_and_disarm_replace_the_others(queue, sent, urgent):
    queue.add(Op.CLEAR, 0.0)
    queue.add(Op.ARM, 0.0)
    queue.add(urgent, 0.0)
    assert sent.ops == [Op.CLEAR, urgent]
    assert queue.acknowledge(Ack(Op.CLEAR, 0, 0, 0), 0.01) is None
    assert queue.acknowledge(Ack(urgent, 1, 0, 0), 0.01) == OperationOutcome(urgent, Result.OK)
    queue.poll(1.0)
    assert sent.ops == [Op.CLEAR, urgent]


def test_a_result_of_a_newer_minor_version_is_a_refusal(queue):
    queue.add(Op.ARM, 0.0)
    outcome = queue.acknowledge(Ack(Op.ARM, 0, 99, 0), 0.01)
    assert outcome == OperationOutcome(Op.ARM, Result.WRONG_STATE)


def test_repeats_keep_the_number_of_their_operation(queue, sent):
    for k, op in enumerate((Op.CLEAR, Op.ARM)):
        queue.add(op, k)
        queue.poll(k + 0.05)
        queue.acknowledge(Ack(op, 2 * k, Result.OK, 0), k + 0.06)
    assert sent.numbers == [0, 0, 1, 1]


def test_an_operation_with_an_old_echo_is_sent_again_and_given_up_as_stale(queue, sent):
    queue.add(Op.CLEAR, 0.0)
    assert queue.acknowledge(Ack(Op.CLEAR, 0, Result.STALE, 0), 0.01) is None
    queue.poll(0.05)
    assert sent.numbers == [0, 0]
    assert queue.acknowledge(Ack(Op.CLEAR, 1, Result.OK, 0), 0.06).result is Result.OK
    queue.add(Op.ARM, 1.0)
    assert queue.acknowledge(Ack(Op.ARM, 2, Result.STALE, 0), 1.01) is None
    outcomes = [outcome for k in range(100) if (outcome := queue.poll(1.0 + 0.01 * k))]
    assert outcomes == [OperationOutcome(Op.ARM, Result.STALE)]


def test_nothing_is_resent_after_the_session(queue, sent):
    queue.add(Op.ARM, 0.0)
    queue.clear()
    assert queue.poll(1.0) is None
    assert sent.ops == [Op.ARM]
