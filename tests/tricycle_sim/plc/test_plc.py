"""What both PLCs share against sections 3 to 5 of docs/protocol.md.

Every test runs on two backends: the emulation in Python and the firmware's own C logic.
"""

import zlib

import pytest
from cobs import cobs
from plc_bench import DRIVE, ENABLE, ESTOP, STANDSTILL, STEER, Fault, Op, Result, State

from tricycle_bridge.protocol import messages as m
from tricycle_sim.plc.plc import to_i16, to_u16

# ---- handshake ----


def test_boot_is_announced_without_a_session_then_telemetry_flows(make_bench):
    bench = make_bench(STEER, boot_count=41)
    bench.tick(3)
    boot, *states = bench.received
    assert boot == m.Event(0, m.EventCode.BOOT, State.SAFE, 0)
    assert [s.t for s in states] == [0, 10_000, 20_000]
    ack = bench.hello()
    assert (ack.board, ack.nonce, ack.boot_count, ack.watchdog) == (1, 99, 42, 200)


def test_hello_to_any_board_is_answered_and_to_another_is_not(bench):
    other = 3 - bench.board
    assert len(bench.send(m.Hello(0, 15, 1), board=m.Board.ANY)) == 1
    assert bench.send(m.Hello(0, other, 1), board=m.Board.ANY) == []
    assert bench.send(m.Hello(0, other, 1), board=m.Board(other)) == []


def test_hello_disarms(armed):
    assert armed.state.flags & m.StateFlag.ENABLED
    armed.hello(session=9)
    state = armed.tick()
    assert (state.state, state.command_age) == (State.SAFE, 255)
    assert not state.flags & m.StateFlag.ENABLED


def test_a_reset_forgets_the_session(armed):
    armed.plc.reset(m.ResetCause.WATCHDOG)
    assert armed.command() == []
    state = armed.tick()
    assert (state.state, state.faults) == (State.SAFE, Fault.WDT_RESET)
    armed.command()
    assert armed.plc.session == 0
    armed.hello(session=11)
    assert armed.set_up() is Result.OK
    armed.drive(5)
    assert armed.control(Op.ARM) is Result.WRONG_STATE  # the fault needs CLEAR
    assert armed.control(Op.CLEAR) is Result.OK
    assert armed.control(Op.ARM) is Result.OK


# ---- arming ----


def test_arming_needs_five_fresh_enabled_commands_in_a_row(bench):
    bench.drive(4)
    assert bench.control(Op.ARM) is Result.PRECONDITIONS
    bench.drive(1, flags=0)
    bench.drive(4)
    assert bench.control(Op.ARM) is Result.PRECONDITIONS
    bench.command(echo=m.echo_of(bench.now - 200_000))  # stale: the row begins anew
    bench.drive(4)
    assert bench.control(Op.ARM) is Result.PRECONDITIONS
    bench.drive(1)
    bench.tick(21)  # the newest is older than 200 ms
    assert bench.control(Op.ARM) is Result.PRECONDITIONS
    bench.drive(4)  # the row began anew
    assert bench.control(Op.ARM) is Result.PRECONDITIONS
    bench.drive(1)
    assert bench.control(Op.ARM) is Result.OK
    assert bench.control(Op.ARM) is Result.OK  # already satisfied


@pytest.mark.parametrize(("age", "result"), [(200_000, Result.OK), (200_001, Result.PRECONDITIONS)])
def test_the_newest_command_may_be_200_ms_old_for_arming(bench, age, result):
    bench.drive(5)  # the last command came a tick ago
    bench.now += age - 10_000
    assert bench.control(Op.ARM) is result


@pytest.mark.parametrize("op", [Op.DISARM, Op.ESTOP, Op.CLEAR])
def test_satisfied_operations_are_answered_with_ok(bench, op):
    assert bench.control(op) is Result.OK
    assert bench.control(op) is Result.OK


@pytest.mark.parametrize(("inverted", "guard"), [(0xFF, 0xA5), (0xFE, 0xA4), (0xFF, 0)])
def test_ctrl_is_refused_where_any_guard_byte_is_wrong(bench, inverted, guard):
    bench.drive(5)
    seq = bench.seq
    (ack,) = bench.send(m.Control(1, inverted, 1, guard, m.echo_of(bench.now)))
    assert ack == m.Ack(1, seq, Result.BAD_GUARD, State.SAFE)


def test_ctrl_is_refused_for_unknown_ops(bench):
    (ack,) = bench.send(m.Control.of(9))
    assert ack.result == Result.UNKNOWN_OP


def test_ctrl_of_another_session_is_not_answered(armed):
    assert armed.send(m.Control.of(Op.DISARM), session=8) == []
    assert armed.stats().session == 1


# ---- leaving ARMED ----


@pytest.mark.parametrize("phase", range(0, 10_000, 1_111))
def test_the_watchdog_trips_after_200_to_210_ms(armed, phase):
    armed.now += phase
    armed.command()
    since = armed.now
    armed.now += 10_000 - phase
    while armed.plc.state is State.ARMED:
        armed.tick()
    trip = State.ARMED << 4 | State.STOPPING
    (event,) = [e for e in armed.received if isinstance(e, m.Event) and e.states == trip]
    assert 200_000 <= event.t - since < 210_000
    assert event.faults == Fault.CMD_TIMEOUT
    assert armed.stats().watchdog_trips == 1


def test_a_limited_command_is_a_fault_bit_while_it_lasts(armed):
    armed.drive(2, 3.0 if armed.board is STEER else 9.0)
    assert armed.state.faults == Fault.LIMIT
    enabled = m.StateFlag.ENABLED | m.StateFlag.SET_UP
    assert armed.state.flags == enabled | m.StateFlag.LIMITED
    armed.drive(1, 0.1)
    assert (armed.state.faults, armed.state.flags) == (0, enabled)


def test_a_limited_command_is_told_in_every_state_until_it_is_200_ms_old(bench):
    value = 3.0 if bench.board is STEER else 9.0
    bench.drive(5, value)
    assert bench.state.faults == Fault.LIMIT
    assert bench.state.flags & m.StateFlag.LIMITED
    bench.control(Op.ESTOP)
    bench.drive(1, value)
    assert bench.state.faults == Fault.LIMIT | Fault.ESTOP_HOST
    assert bench.control(Op.CLEAR) is Result.OK
    bench.command(value)
    bench.tick(20)
    assert bench.state.faults == Fault.LIMIT
    bench.tick()
    assert bench.state.faults == 0
    assert not bench.state.flags & m.StateFlag.LIMITED


def test_a_limited_command_does_not_block_arming(make_bench):
    bench = make_bench(STEER).booted()
    bench.drive(5, 3.0)
    assert bench.control(Op.ARM) is Result.OK


def test_a_timed_out_board_never_arms_again_by_itself(armed):
    armed.tick(25)
    armed.drive(150, flags=ENABLE | STANDSTILL)
    assert armed.state.state == State.SAFE
    assert armed.state.faults == Fault.CMD_TIMEOUT
    assert armed.control(Op.ARM) is Result.WRONG_STATE
    assert armed.control(Op.CLEAR) is Result.OK
    assert armed.control(Op.ARM) is Result.OK


def test_stale_commands_do_not_feed_the_watchdog(armed):
    old = m.echo_of(armed.now)
    for _ in range(60):
        armed.command(echo=old)
        armed.tick()
    assert armed.plc.state is not State.ARMED
    assert armed.stats().stale > 30


def test_an_echo_is_fresh_up_to_150_units(armed):
    echo = (m.echo_of(armed.now) - 150) & 0xFFFF
    armed.command(echo=echo)
    assert armed.stats().stale == 0
    armed.command(echo=(echo - 1) & 0xFFFF)
    assert armed.stats().stale == 1
    armed.command(echo=(m.echo_of(armed.now) + 1) & 0xFFFF)  # from the future
    assert armed.stats().stale == 2


@pytest.mark.parametrize("how", ["op", "flag", "pin"])
def test_every_emergency_stop_latches_and_cuts_the_outputs(armed, how):
    if how == "op":
        assert armed.control(Op.ESTOP) is Result.OK
    elif how == "flag":
        armed.command(flags=ENABLE | ESTOP)
    armed.tick(estop_pressed=how == "pin")
    fault = Fault.ESTOP_HW if how == "pin" else Fault.ESTOP_HOST
    assert (armed.state.state, armed.state.faults) == (State.ESTOP, fault)
    if armed.board is DRIVE:
        assert (armed.output.motor_on, armed.output.brake) == (False, 1.0)
    armed.drive(5)
    if how == "pin":
        armed.tick(estop_pressed=True)
        assert armed.control(Op.CLEAR) is Result.PRECONDITIONS
    armed.tick(estop_pressed=False)
    assert armed.control(Op.ARM) is Result.WRONG_STATE
    assert armed.control(Op.CLEAR) is Result.OK
    assert armed.tick().state == State.SAFE


# ---- limits ----


# ---- fields of state frames ----


@pytest.mark.parametrize(
    ("value", "i16", "u16"),
    [(0.6, 1, 1), (-1.2, -1, 0), (32_767, 32_767, 32_767), (32_768, 32_767, 32_768),
     (-32_768, -32_768, 0), (-32_769, -32_768, 0), (65_535, 32_767, 65_535),
     (65_536, 32_767, 65_535), (0, 0, 0)],
)  # fmt: skip
def test_a_value_is_rounded_and_limited_to_its_field(value, i16, u16):
    assert (to_i16(value), to_u16(value)) == (i16, u16)


# ---- sequence, counters, clock ----


@pytest.mark.parametrize("session", [0, 1, 7])
def test_a_plc_without_a_session_answers_nothing_but_hello(make_bench, session):
    bench = make_bench(STEER)
    bench.tick()
    assert bench.send(m.Ping(1), session=session) == []
    assert bench.send(m.StatsRequest(), session=session) == []
    bench.hello()
    assert bench.stats().session == 2


def test_frames_are_numbered_on_from_the_hello(bench):
    bench.send(m.Hello(0, bench.board, 1), seq=200)
    assert bench.send(m.Ping(1), seq=200) == []  # a duplicate of it
    bench.tick()
    assert len(bench.send(m.Ping(1), seq=203)) == 1
    stats = bench.stats()
    assert (stats.duplicate, stats.seq_gap) == (1, 2)


def test_hello_ack_identifies_the_board(make_bench):
    for board in (STEER, DRIVE):
        ack = make_bench(board, boot_count=0xFFFE).booted().hello()
        capabilities = m.Capability(7)
        assert ack == m.HelloAck(0, board, 2, 0, 0, 1, 0xFFFF, 0, 99, capabilities, 200)


def test_a_state_frame_has_its_flags_and_the_age_of_the_newest_command(bench):
    state = bench.tick()
    set_up = m.StateFlag.SET_UP
    assert (state.flags, state.command_age, bench.received[-1]) == (set_up, 255, state)
    seq = bench.seq
    bench.command(flags=0)
    assert bench.tick().flags == set_up
    bench.command(flags=ENABLE)
    ages = [bench.tick(estop_pressed=k == 300).command_age for k in range(301)]
    assert ages == [min(k, 255) for k in range(301)]
    flags = m.StateFlag.ENABLED | m.StateFlag.ESTOP_PRESSED | set_up
    assert (bench.state.flags, bench.state.command_seq) == (flags, seq + 1)


def test_an_age_is_in_whole_ticks(bench):
    bench.now += 1
    bench.command()
    bench.now += 9_999
    assert bench.tick().command_age == 0
    assert bench.tick().command_age == 1
    bench.hello()
    assert bench.tick().command_age == 255
    bench.command()
    bench.now += 2_560_000  # a tick that came late
    assert bench.tick().command_age == 255


def test_an_old_command_is_not_young_again_when_the_clock_wraps(bench):
    bench.command()
    bench.tick()
    bench.now += 3_000_000
    assert bench.tick().command_age == 255
    bench.now += (1 << 32) - 3_020_000
    assert bench.tick().command_age == 255


def test_a_long_row_of_commands_arms_too(bench):
    for _ in range(258):  # more than a byte counts
        bench.command()
    assert bench.control(Op.ARM) is Result.OK


def test_the_row_of_commands_begins_anew_after_200_ms_without_one(bench):
    for silent, result in ((20, Result.OK), (21, Result.PRECONDITIONS)):
        bench.drive(4)
        bench.command()
        bench.tick(silent)  # at the first with the command, so one less has passed
        bench.command()
        assert bench.control(Op.ARM) is result
        bench.control(Op.DISARM)
        bench.drive(1, flags=0)


def wire(ver_node, code, payload, session=7, seq=77):
    raw = bytes([ver_node, code, seq, session]) + payload
    return cobs.encode(raw + zlib.crc32(raw).to_bytes(4, "little")) + b"\0"


def test_frames_are_counted_by_the_rule_that_drops_them(bench):
    own, other = bench.board, 3 - bench.board
    ping, token = m.Ping.ID, b"abcd"
    foreign = m.DriveCommand.ID if own is STEER else m.SteerCommand.ID
    hello = bytes([0, own, 1, 2, 3, 4])
    for data, counter in (
        (wire(0x40 | own, ping, token), "ok"),
        (wire(0x40 | own, ping, token + b"newer", seq=78), "ok"),
        (wire(0x20 | own, ping, token), "version"),
        (wire(0x00 | own, ping, token), "version"),
        (wire(0x40 | other, ping, token), "unknown"),
        (wire(0x40 | 15, ping, token), "unknown"),
        (wire(0x50 | own, ping, token), "unknown"),
        (wire(0x50 | own, m.Hello.ID, hello), "unknown"),
        (wire(0x40 | other, m.Hello.ID, hello), "unknown"),
        (wire(0x40 | own, foreign, bytes(10)), "unknown"),
        (wire(0x40 | own, 0x7F, token), "unknown"),
        (wire(0x50 | own, m.Pong.ID, bytes(12)), "unknown"),
        (wire(0x40 | own, ping, token, session=8), "session"),
        (wire(0x40 | own, ping, token, session=0), "session"),
        (wire(0x40 | own, ping, token[:3]), "length"),
        (wire(0x40 | own, m.Hello.ID, hello[:5]), "length"),
        (b"\x11" * 50 + b"\0", "length"),
        (b"\x05abc\0", "cobs"),
        (cobs.encode(b"12345678") + b"\0", "crc"),
        (b"\0\0\0", None),
    ):
        before = bench.stats()
        bench.tick()  # so that there is room for an answer
        answer = bench.plc.receive(data, bench.now)
        bench.tick()
        after = bench.stats()
        assert bool(answer) is (counter == "ok"), data.hex()
        expected = {"ok": before.ok + 1}  # the request of the counters itself
        if counter:
            expected[counter] = expected.get(counter, getattr(before, counter)) + 1
        counters = ("seq_gap", "duplicate")  # by frames of this test and of the bench
        for name in set(vars(before)) - set(counters):
            assert getattr(after, name) == expected.get(name, getattr(before, name)), data.hex()


@pytest.mark.parametrize("major", [0, 1, 7])
def test_hello_of_another_major_is_answered(bench, major):
    data = wire(major << 5 | bench.board, m.Hello.ID, bytes([0, bench.board, 9, 0, 0, 0]))
    (frame,) = bench.decoder.feed(bench.plc.receive(data, bench.now))
    assert (frame.major, frame.message.nonce) == (2, 9)


def test_every_frame_of_a_plc_has_the_next_number(bench):
    first = bench.frames[-1].seq
    bench.tick()
    bench.send(m.Ping(1))
    bench.tick(2)
    bench.send(m.LimitsRequest())
    assert [f.seq for f in bench.frames[-5:]] == [(first + k) & 0xFF for k in range(1, 6)]


def test_counters_begin_at_zero(bench):
    assert bench.stats() == m.Stats(3, *[0] * 14)  # HELLO, SETUP and the request itself
    bench.plc.drop_sent(3)
    assert bench.stats() == m.Stats(4, *[0] * 7, 3, *[0] * 6)


def test_duplicates_are_ignored_and_gaps_counted(armed):
    seq = armed.seq
    assert len(armed.send(m.Ping(1), seq=seq)) == 1
    assert armed.send(m.Ping(1), seq=seq) == []
    armed.drive(1)
    assert len(armed.send(m.Ping(1), seq=(seq + 5) & 0xFF)) == 1
    stats = armed.stats()
    assert (stats.duplicate, stats.seq_gap) == (1, 3)


def test_the_watchdog_and_the_echo_hold_across_the_wrap_of_the_clock(make_bench):
    bench = make_bench(STEER, start_us=(1 << 32) - 500_000).booted().armed()
    bench.drive(100, 0.1)
    assert bench.state.t < 1_000_000
    assert bench.state.state == State.ARMED
    assert bench.stats().stale == 0
