"""Preconditions and sequence of arming, against both emulated PLCs."""

import dataclasses
import math

import pytest

from tricycle_bridge.arming import (
    ARMING_PATIENCE,
    ArmingSequence,
    arming_refusal,
    board_condition,
)
from tricycle_bridge.commands.command_stream import Source, VehicleCommand
from tricycle_bridge.plc_link.operations import OperationOutcome
from tricycle_bridge.protocol.messages import Board, Op, PlcState, Result
from tricycle_sim.plc import DriveMeasurement, SteerMeasurement

STEER, DRIVE = Board.STEER, Board.DRIVE
STANDSTILL = VehicleCommand(0.0, 0.0)


def test_arming_at_once_after_a_stop_says_what_to_wait_for(vehicle):
    vehicle.arm()
    vehicle.bridge.stop("the operator's wish")
    assert vehicle.arm() == (False, "not armed: steer PLC: still stopping")
    vehicle.until_stopped()
    assert vehicle.arm() == (True, "armed")


def test_arming_needs_no_commander(vehicle):
    vehicle.target = None
    vehicle.step(50)
    assert vehicle.arm() == (True, "armed")
    vehicle.step(500)
    assert vehicle.bridge.armed  # at rest, until somebody commands


@pytest.mark.parametrize("begins", [1, 4, 6])
def test_a_speed_that_is_commanded_while_the_boards_arm_ends_the_arming(vehicle, begins):
    vehicle.bridge.arm(vehicle.now, vehicle.outcomes.append)
    vehicle.step(begins)
    assert not vehicle.outcomes
    vehicle.target = (0.0, 1.5)
    vehicle.step()
    assert vehicle.outcomes == [(False, "not armed: commanded speed is 1.50 m/s, must be 0")]
    vehicle.step(100)
    assert vehicle.warnings == ["stopped: commanded speed is 1.50 m/s, must be 0"]
    assert {plc.state for plc in vehicle.plcs.values()} == {PlcState.SAFE}
    assert vehicle.travel == 0.0
    vehicle.target = (0.0, 0.0)
    vehicle.step()
    assert vehicle.arm() == (True, "armed")


def test_a_speed_of_before_the_request_that_comes_late_does_not_end_the_arming(vehicle):
    vehicle.target = None
    vehicle.step(20)
    vehicle.bridge.arm(vehicle.now, vehicle.outcomes.append)
    moving = VehicleCommand(0.0, 1.5)
    stamp, now = vehicle.now - 0.05, vehicle.now + 0.001
    vehicle.bridge.set_command(moving, stamp=stamp, now=now, source=Source.JOINT_COMMANDS)
    vehicle.step(30)
    assert vehicle.outcomes == [(True, "armed")]
    assert vehicle.travel == 0.0


def _moving(v):
    v.measured[DRIVE] = DriveMeasurement(speed=0.35)
    v.step()


def _supply(v):
    v.measured[DRIVE] = DriveMeasurement(supply=31.5)
    v.step()


def _not_set_up(v):
    v.bridge.links[STEER].set_up = False


def _badly_set_up(v):
    link = v.bridge.links[DRIVE]
    link.setup = dataclasses.replace(link.setup, max_speed=5000)
    v.plcs[DRIVE].reset()
    v.step(100)


def _moving_command(v):
    v.target = (0.0, 0.5)
    v.step()


def _cut_steer(v):
    v.cut.add(STEER)
    v.step(40)


def _inactive(v):
    v.bridge.active = False


def _pressed(v):
    v.measured[DRIVE] = DriveMeasurement(estop_pressed=True)
    v.plcs[DRIVE].tick(round((v.now - 1000) * 1e6), v.measured[DRIVE])
    data, _ = v.plcs[DRIVE].tick(round((v.now - 1000) * 1e6), v.measured[DRIVE])
    v.bridge.receive(DRIVE, data, v.now)


@pytest.mark.parametrize(
    ("cause", "reason"),
    [
        (_moving, "the vehicle moves at 0.35 m/s"),
        (_supply, "drive PLC: supply is 31.5 V, must be at least 40.0 V"),
        (_not_set_up, "steer PLC is not set up yet"),
        (
            _badly_set_up,
            "drive PLC refused its set-up: out of range: "
            "max_speed 5.000 m/s, the board allows 4.800 m/s",
        ),
        (_moving_command, "commanded speed is 0.50 m/s, must be 0"),
        (_cut_steer, "steer PLC: no telemetry for"),
        (_inactive, "the bridge is not active"),
        (_pressed, "drive PLC: hardware e-stop pressed"),
    ],
)
def test_every_refusal_says_why(vehicle, cause, reason):
    cause(vehicle)
    success, text = vehicle.arm()
    assert not success
    assert text.startswith(f"not armed: {reason}")
    assert not vehicle.bridge.armed


def test_when_one_board_does_not_arm_neither_stays_armed(vehicle):
    vehicle.measured[STEER] = SteerMeasurement(adc=2)
    success, text = vehicle.arm()
    assert not success
    assert text == "not armed: steer PLC is SAFE and refused ARM: preconditions"
    vehicle.step(150)
    assert {p.state for p in vehicle.plcs.values()} <= {PlcState.SAFE, PlcState.FAULT}


def test_every_precondition_is_checked(vehicle):
    links, now = vehicle.bridge.links, vehicle.now
    assert arming_refusal(links, STANDSTILL, now, enabled=False) is None
    assert arming_refusal(links, None, now, enabled=False) is None
    late = now + 0.2
    assert arming_refusal(links, STANDSTILL, late, enabled=False) == (
        "steer PLC: telemetry 0.20 s old"
    )
    vehicle.measured[STEER] = SteerMeasurement(adc=2)
    vehicle.step(2)
    assert arming_refusal(links, STANDSTILL, vehicle.now, enabled=False) == (
        "steer PLC: its potentiometer is at 2 counts, must be 5 to 1018: a broken wire"
    )


def test_a_board_in_estop_is_set_up_between_clear_and_arm(vehicle):
    vehicle.plcs[STEER].reset()
    vehicle.measured[STEER] = SteerMeasurement(estop_pressed=True)
    vehicle.step(50)
    vehicle.measured[STEER] = SteerMeasurement()
    vehicle.step(2)
    link = vehicle.bridge.links[STEER]
    assert link.plc_state == PlcState.ESTOP
    assert not link.set_up
    assert vehicle.arm() == (True, "armed")
    assert link.set_up


def test_a_board_that_refused_its_set_up_in_estop_is_armed_after_it(vehicle):
    """Its first SETUP is lost, and the e-stop is pressed before the second."""
    plc, link = vehicle.plcs[STEER], vehicle.bridge.links[STEER]
    receive = plc.receive
    plc.receive = lambda data, now_us: receive(
        b"".join(f + b"\0" for f in data.split(b"\0") if f and len(f) < 17), now_us
    )
    plc.reset()
    vehicle.step(6)
    vehicle.measured[STEER] = SteerMeasurement(estop_pressed=True)
    vehicle.step()
    plc.receive = receive
    vehicle.step(50)
    vehicle.measured[STEER] = SteerMeasurement()
    vehicle.step(2)
    assert link.problem == "steer PLC refused its set-up: wrong state"
    vehicle.bridge.arm(vehicle.now, vehicle.outcomes.append)
    vehicle.step(110)  # SETUP is sent once per second
    assert vehicle.outcomes == [(True, "armed")]


def test_an_armed_board_that_the_operator_did_not_arm_is_still_stopping(vehicle):
    vehicle.arm()
    links, now = vehicle.bridge.links, vehicle.now
    assert arming_refusal(links, STANDSTILL, now, enabled=True) is None
    assert arming_refusal(links, STANDSTILL, now, enabled=False) == "steer PLC: still stopping"


def test_the_condition_of_a_board_names_state_and_faults(vehicle):
    link = vehicle.bridge.links[STEER]
    assert board_condition(link) == "steer PLC is SAFE"
    vehicle.bridge.closed(STEER, "unplugged")
    assert board_condition(link) == "steer PLC is lost"


@pytest.fixture
def sequence(vehicle):
    return ArmingSequence(vehicle.bridge.links, vehicle.now)


class RecordingLink:
    """A link that only notes the operations that it is given."""

    def __init__(self):
        self.operations = []
        self.plc_state = PlcState.SAFE
        self.set_up = True

    def operate(self, op, _now):
        self.operations.append(op)


def test_arm_is_sent_after_both_boards_are_cleared_and_a_row_of_commands():
    links = {STEER: RecordingLink(), DRIVE: RecordingLink()}
    sequence = ArmingSequence(links, 0.0)

    def operations():
        sequence.advance(0.1)
        assert links[STEER].operations == links[DRIVE].operations
        return links[STEER].operations

    sequence.take_outcome(STEER, OperationOutcome(Op.CLEAR, Result.OK))
    for _ in range(6):
        sequence.count_command()
    assert operations() == [Op.CLEAR]  # the drive is not cleared yet
    sequence.take_outcome(DRIVE, OperationOutcome(Op.CLEAR, Result.OK))
    assert operations() == [Op.CLEAR, Op.ARM]
    for board in links:
        sequence.take_outcome(board, OperationOutcome(Op.ARM, Result.OK))
    assert operations() == [Op.CLEAR, Op.ARM]
    assert not sequence.complete  # the telemetry is not ARMED yet
    for link in links.values():
        link.plc_state = PlcState.ARMED
    operations()
    assert (sequence.complete, sequence.failure) == (True, None)


def test_five_commands_are_not_enough():
    links = {STEER: RecordingLink(), DRIVE: RecordingLink()}
    sequence = ArmingSequence(links, 0.0)
    for board in links:
        sequence.take_outcome(board, OperationOutcome(Op.CLEAR, Result.OK))
    for _ in range(5):
        sequence.count_command()
    sequence.advance(0.1)
    assert links[STEER].operations == [Op.CLEAR]


@pytest.mark.parametrize(
    ("result", "failure"),
    [
        (None, "drive PLC did not answer CLEAR"),
        (Result.PRECONDITIONS, "drive PLC is SAFE and refused CLEAR: preconditions"),
    ],
)
def test_an_operation_that_fails_ends_the_sequence(sequence, result, failure):
    sequence.take_outcome(DRIVE, OperationOutcome(Op.CLEAR, result))
    assert sequence.failure == failure


def test_the_sequence_has_a_time_limit(vehicle, sequence):
    sequence.advance(vehicle.now + ARMING_PATIENCE)
    assert sequence.failure is None
    sequence.advance(vehicle.now + ARMING_PATIENCE + 0.01)
    assert sequence.failure == "the PLCs did not arm in time"


def test_a_second_request_does_not_disturb_the_first(vehicle):
    outcomes = []
    vehicle.bridge.arm(vehicle.now, outcomes.append)
    vehicle.bridge.arm(vehicle.now, outcomes.append)
    assert outcomes == [(False, "arming is under way")]
    vehicle.step(30)
    assert outcomes[1:] == [(True, "armed")]


def test_an_arm_that_was_lost_is_not_sent_again_after_the_end_of_the_request(vehicle):
    for board, link in vehicle.bridge.links.items():

        def operate(op, now, board=board, operate=link.operate):
            if op is Op.ARM:
                vehicle.cut.add(board)
            operate(op, now)

        link.operate = operate
    vehicle.bridge.arm(vehicle.now, vehicle.outcomes.append)
    vehicle.step(8)
    assert vehicle.cut == {STEER, DRIVE}
    vehicle.bridge.active = False
    vehicle.bridge.stop("the bridge was deactivated")
    vehicle.cut.clear()
    for _ in range(30):
        vehicle.step()
        assert [p.state for p in vehicle.plcs.values()] == [PlcState.SAFE] * 2


def _lose_commands(vehicle, *boards, duration=math.inf):
    until = vehicle.now + duration
    for board in boards:

        def receive(data, now_us, receive=vehicle.plcs[board].receive):
            frames = data.split(b"\0")
            lost = 17 if vehicle.now < until else 1000  # commands are the long ones
            return receive(b"".join(f + b"\0" for f in frames if 0 < len(f) < lost), now_us)

        vehicle.plcs[board].receive = receive


def test_a_board_that_counted_too_few_commands_is_sent_them_again(vehicle):
    """As where a computer pauses: the board's ARM fails, the operator's does not."""
    steer, sent = vehicle.bridge.links[STEER], []
    operate = steer.operate
    steer.operate = lambda op, now: (sent.append(op), operate(op, now))
    _lose_commands(vehicle, STEER, duration=0.06)
    assert vehicle.arm() == (True, "armed")
    assert sent == [Op.CLEAR, Op.ARM, Op.ARM]


def test_boards_that_lose_the_commands_do_not_arm(vehicle):
    """Every command is lost, so that the boards refuse ARM."""
    _lose_commands(vehicle, STEER, DRIVE)
    armed, text = vehicle.arm()
    assert not armed
    assert text == "not armed: steer PLC is SAFE and refused ARM: preconditions"


def test_a_vehicle_stands_until_both_boards_are_armed_whatever_is_commanded(vehicle):
    _lose_commands(vehicle, STEER)
    vehicle.bridge.arm(vehicle.now, vehicle.outcomes.append)
    while not vehicle.outcomes:
        if vehicle.state(DRIVE) is PlcState.ARMED:
            vehicle.target = (0.3, 1.0)
        vehicle.step()
        assert vehicle.measured[DRIVE].speed == 0.0
    assert vehicle.target == (0.3, 1.0)
    assert not vehicle.outcomes[0].armed
