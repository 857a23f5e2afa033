"""Operations that come twice, late or again from a buffer; answers that are too many.

On both backends (conftest.py).
"""

import pytest
from plc_bench import ENABLE, STEER, Fault, Op, Result, State

from tricycle_bridge.protocol import messages as m


@pytest.fixture
def stopped(armed):
    """In ESTOP by an operation."""
    assert armed.control(Op.ESTOP) is Result.OK
    armed.drive(1)
    assert armed.state.state == State.ESTOP
    return armed


def operation(bench, op, number):
    """An operation as it was sent now, to be sent later, or again."""
    return m.Control.of(op, number, m.echo_of(bench.now))


def test_a_repeat_has_the_first_result_and_is_not_carried_out_again(bench):
    bench.drive(5)
    arm = operation(bench, Op.ARM, 1)
    assert bench.result(arm) is Result.OK
    bench.drive(1)
    bench.tick(25)  # the watchdog
    assert bench.control(Op.DISARM, number=2) is Result.OK
    assert bench.control(Op.CLEAR, number=3) is Result.OK
    clear = operation(bench, Op.CLEAR, 3)
    bench.tick()
    bench.control(Op.ESTOP, number=3)  # carried out whatever its number
    assert bench.result(clear) is Result.OK
    bench.tick()
    assert (bench.state.state, bench.state.faults) == (State.ESTOP, Fault.ESTOP_HOST)


def test_a_repeat_of_a_refusal_is_the_refusal(bench):
    arm = operation(bench, Op.ARM, 1)
    assert bench.result(arm) is Result.PRECONDITIONS
    bench.drive(5)
    assert bench.result(arm) is Result.PRECONDITIONS
    assert bench.control(Op.ARM, number=2) is Result.OK


def test_a_recorded_clear_and_arm_do_nothing_later(bench):
    bench.drive(5)
    recorded = [operation(bench, Op.CLEAR, 1), operation(bench, Op.ARM, 2)]
    assert [bench.result(message) for message in recorded] == [Result.OK, Result.OK]
    bench.control(Op.ESTOP, number=3)
    bench.drive(10)
    assert [bench.result(message) for message in recorded] == [Result.STALE, Result.STALE]
    bench.tick()
    assert (bench.state.state, bench.state.faults) == (State.ESTOP, Fault.ESTOP_HOST)


@pytest.mark.parametrize("op", [Op.CLEAR, Op.ARM])
def test_an_operation_out_of_a_buffer_is_stale_and_does_not_take_its_number(stopped, op):
    number = stopped.operation + 1
    late = operation(stopped, op, number)
    stopped.tick(16)  # 160 ms: more than 150 units of 1.024 ms
    assert stopped.result(late) is Result.STALE
    assert stopped.stats().stale == 1
    assert stopped.state.state == State.ESTOP
    assert stopped.control(Op.CLEAR, number=number) is Result.OK
    assert stopped.tick().state == State.SAFE


def test_an_operation_of_the_future_is_stale(stopped):
    echo = m.echo_of(stopped.now) + 1
    assert stopped.control(Op.CLEAR, echo=echo) is Result.STALE


@pytest.mark.parametrize(
    ("step", "result"), [(1, Result.OK), (127, Result.OK), (128, Result.STALE), (255, Result.STALE)]
)
@pytest.mark.parametrize("first", [0, 200])
def test_a_number_is_new_up_to_127_steps(bench, first, step, result):
    assert bench.control(Op.CLEAR, number=first) is Result.OK
    assert bench.control(Op.CLEAR, number=(first + step) & 0xFF) is result


@pytest.mark.parametrize("op", [Op.DISARM, Op.ESTOP])
@pytest.mark.parametrize("number", [0, 1, 77, 250])
def test_towards_standstill_every_number_and_age_will_do(armed, op, number):
    armed.control(Op.CLEAR, number=77)
    assert armed.control(op, number=number, echo=m.echo_of(armed.now - 60_000_000)) is Result.OK
    state = armed.tick().state
    assert state == (State.SAFE if op is Op.DISARM else State.ESTOP)


def test_a_newer_disarm_takes_its_number(armed):
    clear = operation(armed, Op.CLEAR, 60)
    armed.control(Op.DISARM, number=61)
    assert armed.result(clear) is Result.STALE
    armed.tick()
    armed.control(Op.DISARM, number=20)  # an older one does not
    assert armed.control(Op.CLEAR, number=60) is Result.STALE


@pytest.mark.parametrize(("step", "result"), [(127, Result.STALE), (128, Result.OK)])
def test_the_number_of_a_disarm_is_newer_up_to_127_steps(bench, step, result):
    bench.control(Op.CLEAR, number=10)
    bench.control(Op.DISARM, number=10 + step)
    assert bench.control(Op.CLEAR, number=12) is result


def test_hello_forgets_the_numbers(bench):
    bench.control(Op.CLEAR, number=50)
    assert bench.control(Op.CLEAR, number=49) is Result.STALE
    bench.hello(session=9)
    assert bench.control(Op.CLEAR, number=49) is Result.OK


def test_what_is_refused_by_its_guards_or_is_unknown_takes_no_number(bench):
    echo = m.echo_of(bench.now)
    assert bench.result(m.Control(Op.CLEAR, 0, 9, m.Control.GUARD, echo)) is Result.BAD_GUARD
    assert bench.result(m.Control.of(Op.SETUP, 9, echo)) is Result.UNKNOWN_OP
    assert bench.control(Op.CLEAR, number=5) is Result.OK


# ---- too many answers ----


def test_answers_between_two_ticks_are_few(bench):
    bench.tick()
    before = bench.frames[-1].seq
    answers = [bench.send(m.Ping(k)) for k in range(6)]
    assert [len(answer) for answer in answers] == [1, 1, 0, 0, 0, 0]  # 22 bytes each of 64
    bench.tick()
    assert (bench.frames[-1].seq - before) & 0xFF == 7  # those not sent have their numbers
    assert bench.stats().tx_drop == 4


def test_a_small_answer_fits_behind_a_large_one_that_did_not(bench):
    bench.tick()
    assert len(bench.send(m.StatsRequest())) == 1  # 42 bytes
    assert bench.send(m.StatsRequest()) == []
    assert len(bench.send(m.Ping(1))) == 1  # 22: 64 in all
    assert bench.send(m.Ping(1)) == []


def test_what_an_operation_does_is_done_without_an_answer_too(armed):
    armed.stats()
    armed.send(m.Ping(1))
    assert armed.send(operation(armed, Op.DISARM, 9)) == [
        m.Event(armed.now & 0xFFFFFFFF, 1, State.ARMED << 4 | State.SAFE, 0)
    ]
    assert armed.tick().state == State.SAFE


def test_a_flood_of_pings_takes_no_telemetry_away(armed):
    armed.received.clear()
    for _ in range(50):
        for k in range(20):
            armed.send(m.Ping(k))
        armed.drive(1)
    states = [x for x in armed.received if isinstance(x, m.SteerState | m.DriveState)]
    pongs = [x for x in armed.received if isinstance(x, m.Pong)]
    assert (len(states), len(pongs)) == (50, 100)
    assert armed.state.state == State.ARMED


# ---- the first byte, the clock ----


def test_the_event_of_a_boot_is_heard_behind_a_cut_frame(make_bench):
    bench = make_bench(STEER)
    bench.decoder.feed(b"\x1f\x31\x90cut off by the reset")
    bench.tick()
    assert bench.received[0] == m.Event(0, m.EventCode.BOOT, State.SAFE, 0)
    bench.plc.reset()
    bench.decoder.feed(b"\x1f\x31\x90cut off by the reset")
    bench.received.clear()
    bench.tick()
    assert isinstance(bench.received[0], m.Event)


def test_an_armed_board_does_not_care_that_its_clock_wraps(make_bench):
    for board in (m.Board.STEER, m.Board.DRIVE):
        bench = make_bench(board, start_us=(1 << 32) - 200_000).booted().armed()
        bench.drive(100, 0.3)
        assert (bench.state.state, bench.state.faults) == (State.ARMED, 0)
        assert bench.control(Op.CLEAR) is Result.WRONG_STATE
        bench.drive(1, flags=ENABLE)
        assert bench.control(Op.DISARM) is Result.OK


def test_an_operation_is_judged_across_the_wrap_of_the_clock(make_bench):
    bench = make_bench(STEER, start_us=(1 << 32) - 100_000).booted()
    clear = operation(bench, Op.CLEAR, 1)
    bench.tick(12)
    assert bench.result(clear) is Result.OK
    late = operation(bench, Op.CLEAR, 2)
    bench.tick(17)
    assert bench.result(late) is Result.STALE
