"""Set-points are held per tick and slewed, wherever they are made."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tricycle_sim.commands import Commands
from tricycle_sim.setpoints import command_rows, delayed, slew, slew_all, tick_count


@settings(deadline=None)  # the first call compiles
@given(setpoint=st.floats(-5, 5), target=st.floats(-5, 5), rate=st.floats(0.01, 10))
def test_slew_never_exceeds_the_rate_nor_the_target(setpoint, target, rate):
    after = slew(setpoint, target, rate)
    assert abs(after - setpoint) <= rate * 0.01 + 1e-12
    assert min(setpoint, target) <= after <= max(setpoint, target)
    if abs(target - setpoint) <= rate * 0.01:
        assert after == target


def test_slew_moves_by_rate_times_tick():
    assert slew(0.0, 1.0, 2.0) == pytest.approx(0.02)
    assert slew(0.0, -1.0, 2.0) == pytest.approx(-0.02)


def test_the_newest_row_whose_time_has_come_rules_the_tick():
    commands = Commands([0.0, 0.02, 0.055, 0.1], np.zeros(4), np.zeros(4))
    assert command_rows(commands).tolist() == [0, 0, 1, 1, 1, 1, 2, 2, 2, 2]


@given(st.integers(1, 100_000))
def test_ticks_survive_rounding_of_times(count):
    assert tick_count(count * 0.01) == count
    assert tick_count(float(np.arange(count + 1)[-1]) / 100.0) == count


def test_commands_at_the_slew_limit_do_not_lag():
    rows = np.repeat(np.arange(10) * 0.04, 2)  # 50 Hz rows, 2 rad/s
    setpoints, lag = slew_all(rows, 2.0)
    assert setpoints[-1] == pytest.approx(rows[-1])
    assert not lag.any()


def test_a_step_lags_until_the_setpoint_arrives():
    setpoints, lag = slew_all(np.full(20, 0.3), 2.0)
    assert setpoints[:3] == pytest.approx([0.02, 0.04, 0.06])
    assert lag[0] == pytest.approx(0.28)
    assert setpoints[15] == 0.3
    assert lag[14:].tolist() == [0.0] * 6


def test_lag_is_what_the_next_tick_does_not_make_up_for():
    reach = 2.0 * 0.01
    for steps, lag in ((1.0, 0.0), (2.0, 0.0), (2.5, 1.5)):
        assert slew_all(np.array([steps * reach]), 2.0)[1] == pytest.approx([lag * reach])


@given(
    setpoints=st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=20),
    before=st.floats(-5.0, 5.0),
    delay=st.floats(0.0, 0.3),
)
def test_a_delay_moves_setpoints_and_a_little_more_moves_them_a_little(setpoints, before, delay):
    told = np.array(setpoints)
    assert delayed(told, 0.0, before) == pytest.approx(told)
    later = delayed(told, 0.02, before)
    assert later == pytest.approx(np.concatenate([[before, before], told])[: len(told)])
    jump = np.abs(np.diff(np.append(before, told))).max()
    more = delayed(told, delay + 1e-6, before)
    assert np.abs(more - delayed(told, delay, before)).max() <= 1.01e-4 * jump + 1e-9
