"""The bridge's clock beside a computer's clock that is set."""

import pytest

from tricycle_bridge.host_clock import HostClock


@pytest.mark.parametrize("step", [3600.0, -3600.0, 0.03])
def test_a_step_is_told_once_and_stamps_follow_it(step):
    clock = HostClock(ros=1e9, steady=50.0)
    assert clock.find_step(1e9 + 1.0, 51.0) is None
    assert clock.find_step(1e9 + 2.0 + step, 52.0) == pytest.approx(step)
    assert clock.find_step(1e9 + 3.0 + step, 53.0) is None
    assert clock.to_ros(54.0) == pytest.approx(1e9 + 4.0 + step)
