"""SETUP and SUPPLY, on both backends (conftest.py)."""

import pytest
from plc_bench import DRIVE, SETUP, STEER, Fault, Op, Result, State

from tricycle_bridge.protocol import messages as m
from tricycle_bridge.protocol.messages import StateFlag

LIMITS = {
    STEER: {"max_angle": 7461, "max_rate": 3000, "supply_low": 0, "supply_high": 0},
    DRIVE: {
        "max_speed": 4800,
        "max_acceleration": 2000,
        "pulse": 15253,
        "tyre_radius": 3350,
        "torque": 3500,
        "regenerative_torque": 1500,
        "power": 250,
        "mass_low": 400,
        "mass_high": 1000,
        "supply_low": 0,
        "supply_high": 0,
        "throttle_low": 0,
        "throttle_high": 0,
    },
}
TIGHTER = {
    STEER: {"max_angle": 5000, "max_rate": 1000, "supply_low": 11_000, "supply_high": 13_000},
    DRIVE: {
        "max_speed": 2000,
        "max_acceleration": 1000,
        "pulse": 20_000,
        "tyre_radius": 2500,
        "torque": 2000,
        "regenerative_torque": 800,
        "power": 200,
        "mass_low": 500,
        "mass_high": 700,
        "supply_low": 44_000,
        "supply_high": 56_000,
        "throttle_low": 1000,
        "throttle_high": 4000,
    },
}


@pytest.fixture(params=[STEER, DRIVE], ids=["steer", "drive"])
def fresh(request, make_bench):
    """With a session, without a SETUP."""
    bench = make_bench(request.param)
    bench.tick()
    bench.hello()
    return bench


def limits(bench):
    """The fields of LIMITS that SETUP has too."""
    bench.tick()
    (answer,) = bench.send(m.LimitsRequest())
    return {name: getattr(answer, name) for name in m.layout(SETUP[bench.board])}


def test_without_a_setup_nothing_arms(fresh):
    assert fresh.tick().flags == 0
    fresh.drive(5)
    assert fresh.control(Op.ARM) is Result.PRECONDITIONS
    assert fresh.set_up() is Result.OK
    fresh.drive(5)
    assert fresh.state.flags & StateFlag.SET_UP
    assert fresh.control(Op.ARM) is Result.OK


def test_a_setup_is_acknowledged_by_its_own_number(fresh):
    seq = fresh.seq
    (ack,) = fresh.send(SETUP[fresh.board](*LIMITS[fresh.board].values()))
    assert ack == m.Ack(Op.SETUP, seq, Result.OK, State.SAFE)


def test_zeros_are_the_board_s_own_values(fresh):
    assert limits(fresh) == LIMITS[fresh.board]
    assert fresh.set_up() is Result.OK
    assert limits(fresh) == LIMITS[fresh.board]


def test_a_setup_is_in_force_until_the_next_hello(fresh):
    assert fresh.set_up(**TIGHTER[fresh.board]) is Result.OK
    assert limits(fresh) == TIGHTER[fresh.board]
    fresh.hello(session=9)
    assert limits(fresh) == LIMITS[fresh.board]
    assert not fresh.tick().flags & StateFlag.SET_UP
    fresh.drive(5)
    assert fresh.control(Op.ARM) is Result.PRECONDITIONS


def test_a_reset_forgets_it(fresh):
    fresh.set_up(**TIGHTER[fresh.board])
    fresh.plc.reset()
    fresh.tick()
    fresh.hello()
    assert limits(fresh) == LIMITS[fresh.board]


def test_only_the_same_setup_is_accepted_again(fresh):
    assert fresh.set_up(**TIGHTER[fresh.board]) is Result.OK
    assert fresh.set_up(**TIGHTER[fresh.board]) is Result.OK
    assert fresh.set_up() is Result.WRONG_STATE
    assert limits(fresh) == TIGHTER[fresh.board]


@pytest.mark.parametrize("op", [Op.ESTOP, Op.ARM])
def test_a_setup_is_for_a_safe_board(bench, op):
    bench.drive(5)
    assert bench.control(op) is Result.OK
    assert bench.set_up(**TIGHTER[bench.board]) is Result.WRONG_STATE
    assert limits(bench) == LIMITS[bench.board]


def test_a_setup_is_accepted_after_a_fault_is_cleared(fresh):
    fresh.control(Op.ESTOP)
    assert fresh.set_up() is Result.WRONG_STATE
    assert fresh.control(Op.CLEAR) is Result.OK
    assert fresh.set_up() is Result.OK


BOUNDS = [
    (STEER, {"max_angle": 7462}, {"max_angle": 7461}),
    (STEER, {"max_rate": 3001}, {"max_rate": 3000}),
    (STEER, {"supply_low": 12_000, "supply_high": 12_000}, {"supply_low": 1, "supply_high": 2}),
    (STEER, {"supply_low": 12_000}, {"supply_high": 12_000}),
    (DRIVE, {"max_speed": 4801}, {"max_speed": 1}),
    (DRIVE, {"max_acceleration": 2001}, {"max_acceleration": 2000}),
    (DRIVE, {"pulse": 999}, {"pulse": 1000}),
    (DRIVE, {"pulse": 60_001}, {"pulse": 60_000}),
    (DRIVE, {"tyre_radius": 199}, {"tyre_radius": 200}),
    (DRIVE, {"tyre_radius": 10_001}, {"tyre_radius": 10_000}),
    (DRIVE, {"torque": 3501}, {"torque": 3500}),
    (DRIVE, {"regenerative_torque": 1501}, {"regenerative_torque": 1500}),
    (DRIVE, {"power": 251}, {"power": 250}),
    (DRIVE, {"mass_low": 9}, {"mass_low": 10}),
    (DRIVE, {"mass_high": 60_001}, {"mass_high": 60_000}),
    (DRIVE, {"mass_low": 701, "mass_high": 700}, {"mass_low": 700, "mass_high": 700}),
    (DRIVE, {"mass_high": 399}, {"mass_high": 400}),  # the lightest is the board's own
    (DRIVE, {"supply_low": 50_000, "supply_high": 40_000}, {"supply_high": 60_000}),
    (DRIVE, {"supply_low": 50_000, "supply_high": 50_000}, {"supply_low": 1, "supply_high": 2}),
    (DRIVE, {"throttle_low": 1000, "throttle_high": 1000}, {"throttle_high": 1000}),
    (DRIVE, {"throttle_low": 1000, "throttle_high": 5001}, {"throttle_high": 5000}),
    (DRIVE, {"throttle_low": 1000}, {}),
]


@pytest.mark.parametrize(("board", "refused", "accepted"), BOUNDS, ids=lambda value: str(value))
def test_a_setup_out_of_range_changes_nothing(make_bench, board, refused, accepted):
    bench = make_bench(board)
    bench.tick()
    bench.hello()
    assert bench.set_up(**refused) is Result.OUT_OF_RANGE
    assert limits(bench) == LIMITS[board]
    assert not bench.tick().flags & StateFlag.SET_UP
    assert bench.set_up(**accepted) is Result.OK
    assert limits(bench) == LIMITS[board] | accepted


def test_the_limits_of_a_steer_setup_hold(make_bench):
    steer = make_bench(STEER).booted(max_angle=3000, max_rate=500).armed()
    steer.drive(10, 0.7)
    assert steer.state.faults == Fault.LIMIT
    assert steer.state.setpoint == 500  # 0.5 rad/s for 0.1 s
    steer.drive(60, 0.7)
    assert steer.state.setpoint == 3000
    assert steer.state.servo == 1500 + round(500 * 0.3 / 0.7854)
    steer.drive(10, -0.3, limit=0.5)
    assert steer.state.faults == 0


def test_the_limits_of_a_drive_setup_hold(make_bench):
    drive = make_bench(DRIVE).booted(max_speed=1000, max_acceleration=500).armed()
    drive.drive(100, 4.0)
    assert drive.state.faults == Fault.LIMIT
    assert drive.state.setpoint == 500
    drive.drive(110, 4.0)
    assert drive.state.setpoint == 1000
    drive.drive(10, 1.0, limit=0.5)
    assert drive.state.faults == 0
    drive.drive(1, 1.0, flags=0)
    drive.drive(49, 1.0, flags=0)
    assert drive.state.setpoint == 400  # it stops with 1.2 m/s^2 all the same


def test_a_command_is_judged_by_the_limits_in_force(fresh):
    """Those of before the SETUP do not let it arm."""
    fresh.drive(5, 0.0 if fresh.board is DRIVE else 0.7)
    assert fresh.set_up(**TIGHTER[fresh.board] | {"supply_low": 0, "supply_high": 0}) is Result.OK
    assert fresh.control(Op.ARM) is Result.PRECONDITIONS


# ---- supply ----

RATED = {STEER: 12.0, DRIVE: 48.0}


@pytest.fixture(params=[STEER, DRIVE], ids=["steer", "drive"])
def watched(request, make_bench):
    """With a supply that is checked."""
    board = request.param
    low, high = round(900 * RATED[board]), round(1100 * RATED[board])
    return make_bench(board).booted(supply_low=low, supply_high=high)


@pytest.mark.parametrize("share", [0.899, 1.101])
def test_a_wrong_supply_is_told_and_blocks_arming(watched, share):
    watched.drive(5)
    watched.tick(supply=share * RATED[watched.board])
    assert watched.state.faults == Fault.SUPPLY
    assert watched.control(Op.ARM) is Result.PRECONDITIONS
    assert watched.control(Op.CLEAR) is Result.OK
    assert watched.control(Op.ARM) is Result.PRECONDITIONS
    watched.tick(supply=RATED[watched.board])
    assert watched.state.faults == 0
    assert watched.control(Op.ARM) is Result.OK


@pytest.mark.parametrize("share", [0.9, 1.0, 1.1])
def test_a_supply_at_its_thresholds_is_right(watched, share):
    assert watched.tick(supply=share * RATED[watched.board]).faults == 0


def test_a_wrong_supply_stops_nothing(watched):
    watched.armed()
    for _ in range(20):
        watched.command()
        watched.tick(supply=0.0)
    assert (watched.state.state, watched.state.faults) == (State.ARMED, Fault.SUPPLY)
    watched.command()
    assert watched.tick(supply=RATED[watched.board]).faults == 0


def test_no_supply_is_checked_without_thresholds(bench):
    assert bench.tick(supply=0.0).faults == 0
