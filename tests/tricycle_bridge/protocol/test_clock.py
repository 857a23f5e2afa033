"""A PLC's clock in the host's time."""

import random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tricycle_bridge.protocol.clock import PlcClock, elapsed_us

WRAP = 1 << 32


def _reading(t: float, *, start: int, drift: float = 0.0) -> int:
    return (start + round(t * 1e6 * (1.0 + drift))) % WRAP


@given(st.integers(0, WRAP - 1), st.integers(0, WRAP - 1))
def test_elapsed_time_holds_across_the_wrap(earlier, step):
    assert elapsed_us((earlier + step) % WRAP, earlier) == step


def test_without_a_ping_a_stamp_is_the_time_of_reception():
    assert PlcClock().to_host(123, received=5.0) == 5.0


@pytest.mark.parametrize("drift", [-5e-3, -2e-3, 0.0, 2e-3, 5e-3])  # of a resonator
def test_stamps_are_right_across_wrap_drift_and_asymmetric_delays(drift):
    rng = random.Random(0)
    start = WRAP - 30_000_000  # 30 s before the wrap
    clock = PlcClock()
    worst, last = 0.0, -1.0
    for tick in range(12_000):
        t = tick * 0.01
        if tick % 50 == 0:
            there, back = rng.expovariate(1000.0), rng.expovariate(1000.0)
            at = _reading(t + there, start=start, drift=drift)
            clock.add_ping(t, at, at + 100, t + there + 100e-6 + back)
            assert clock.round_trip == pytest.approx(there + back, abs=3e-6)
        stamp = clock.to_host(_reading(t, start=start, drift=drift), received=t + 0.02)
        assert stamp > last
        last = stamp
        if tick > 2000:
            worst = max(worst, abs(stamp - t))
    # half of the round trip, and 1 s of drift
    assert worst < 0.007


def test_first_replies_that_waited_for_a_busy_host_are_forgotten_within_half_a_second():
    clock = PlcClock()
    waited = [0.015, 0.012, 0.001, 0.009]  # s
    last = -1.0
    for tick in range(200):
        t = tick * 0.01
        if tick % 7 == 0:
            back = waited[tick // 7] if tick // 7 < len(waited) else 0.002
            clock.add_ping(t, _reading(t, start=0), _reading(t, start=0), t + back)
        stamp = clock.to_host(_reading(t, start=0), received=t + 0.02)
        assert stamp > last
        last = stamp
        if tick >= 50:
            assert stamp == pytest.approx(t, abs=0.0011)  # half a round trip


def test_a_stamp_is_never_in_the_future():
    clock = PlcClock()
    clock.add_ping(10.0, 0, 0, 10.0)
    assert clock.to_host(500_000, received=10.2) == 10.2


@given(st.lists(st.booleans(), min_size=40, max_size=40), st.lists(st.booleans(), max_size=15))
def test_in_simulated_time_stamps_do_not_depend_on_when_replies_are_read(behind_a_tick, late):
    clock = PlcClock(simulated=True)
    for number, behind in enumerate(behind_a_tick):
        t0 = 0.5 * number
        # a busy host's ping is read a tick later; of 16 in a row one is not
        arrived = t0 + 0.002 + (0.01 if number < len(late) and late[number] else 0.0)
        at = _reading(arrived, start=7)
        clock.add_ping(t0, at, at + 300, t0 + (0.01 if behind else 0.0))
    t = 0.5 * len(behind_a_tick)
    stamp = clock.to_host(_reading(t, start=7), received=t + 0.01)
    assert stamp == pytest.approx(t - 0.002, abs=1e-5)
