"""Simulated time of receipt."""

from hypothesis import given
from hypothesis import strategies as st

from trajectory_recorder.receipt_clock import ReceiptClock


def test_a_message_has_the_time_of_its_receipt_not_of_its_handling():
    clock = ReceiptClock()
    assert (clock.at(5), clock.newest) == (None, -1)
    for tick in range(4):
        clock.tick(100 + 10 * tick, 1000 * tick)
    assert clock.newest == 130
    assert [clock.at(t) for t in (90, 100, 109, 110, 125, 999)] == [0, 0, 0, 1000, 2000, 3000]


def test_a_clock_that_was_reset_goes_back():
    clock = ReceiptClock()
    clock.tick(100, 7000)
    clock.tick(110, 0)
    assert (clock.at(105), clock.at(115)) == (7000, 0)


@given(st.integers(1, 50))
def test_it_forgets_only_what_is_long_ago(kept):
    clock = ReceiptClock(kept)
    for tick in range(200):
        clock.tick(tick, 10 * tick)
    assert clock.ticks <= 2 * kept
    assert [clock.at(t) for t in range(200 - kept, 200)] == [10 * t for t in range(200 - kept, 200)]
