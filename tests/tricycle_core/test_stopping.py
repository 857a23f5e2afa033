"""Stopping distances against a stop that is integrated in small steps."""

import numpy as np
import pytest

from tricycle_core.stopping import BRAKED, RAMPED, Cause, stopping_distance


def driven_until_rest(speed, delay, deceleration, step=1e-4):
    """Distance of a vehicle that holds its speed for the delay [m]."""
    time, distance = 0.0, 0.0
    while speed > 0.0:
        slower = speed - (step * deceleration if time >= delay else 0.0)
        distance += 0.5 * step * (speed + max(slower, 0.0))
        time, speed = time + step, slower
    return distance


@pytest.mark.parametrize(
    ("cause", "reaction", "law"),
    [(Cause.ESTOP, 0.05, BRAKED), (Cause.KILLED, 0.25, RAMPED), (Cause.DISABLED, 0.05, RAMPED)],
)
@pytest.mark.parametrize("speed", [0.3, 1.0, 3.0])
def test_the_distance_is_that_of_the_stop_and_the_margin(cause, reaction, law, speed):
    expected = driven_until_rest(speed, reaction + law.delay, law.deceleration) + law.margin
    assert stopping_distance(cause, speed) == pytest.approx(expected, abs=2e-3)
    speeds = np.array([0.0, speed])
    assert stopping_distance(cause, speeds) == pytest.approx([law.margin, expected], abs=2e-3)
