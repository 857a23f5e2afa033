"""Stamps of ROS to numbers and back."""

from types import SimpleNamespace

from hypothesis import given
from hypothesis import strategies as st

from tricycle_core.stamps import nanoseconds_of, seconds_of, split_seconds


def stamp(sec, nanosec):
    return SimpleNamespace(sec=sec, nanosec=nanosec)


@given(st.integers(-(2**31), 2**31 - 1), st.integers(0, 999_999_999))
def test_nanoseconds_are_exact_and_seconds_nearly(sec, nanosec):
    exact = nanoseconds_of(stamp(sec, nanosec))
    assert divmod(exact, 10**9) == (sec, nanosec)
    assert abs(seconds_of(stamp(sec, nanosec)) - exact / 1e9) < 5e-7


@given(st.floats(-1e9, 2e9))
def test_a_time_is_split_into_fields_that_ros_takes(seconds):
    sec, nanosec = split_seconds(seconds)
    assert 0 <= nanosec < 10**9
    assert nanoseconds_of(stamp(sec, nanosec)) == round(seconds * 1e9)
