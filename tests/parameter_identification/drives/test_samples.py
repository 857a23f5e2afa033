"""Times at which several quantities are known."""

import numpy as np
import pytest

from parameter_identification.drives.samples import Samples, common_times, missing


def samples(time):
    time = np.asarray(time, dtype=float)
    return Samples(time, 2.0 * time)


def test_the_slowest_tells_the_times_and_none_are_beyond_what_all_know():
    fast, slow = samples(np.arange(0.05, 3.0, 0.01)), samples(np.arange(0.0, 4.0, 0.1))
    times = common_times([fast, slow])
    np.testing.assert_allclose(times, np.arange(0.1, 2.95, 0.1))
    np.testing.assert_allclose(fast.at(times), 2.0 * times)


def test_nothing_is_known_in_a_gap():
    whole = samples(np.arange(0.0, 3.0, 0.1))
    torn = samples(np.append(np.arange(0.0, 1.0, 0.05), np.arange(2.0, 3.0, 0.05)))
    times = common_times([whole, torn])
    np.testing.assert_allclose(times, [t for t in whole.time if t < 0.96 or t > 1.99])


def test_of_the_same_clock_all_are_known():
    time = [0.0, 0.1, 0.5, 0.6]
    np.testing.assert_allclose(common_times([samples(time), samples(time)]), time)
    np.testing.assert_allclose(common_times([samples([0.5]), samples(time)]), [0.5])
    assert not len(common_times([samples([0.3]), samples(time)]))


@pytest.mark.parametrize(
    ("time", "lost"),
    [
        (np.arange(-1.0, 11.0, 0.05), 0.0),
        (np.append(np.arange(0.0, 4.0, 0.1), np.arange(7.0, 10.0, 0.1)), 3.1),
        (np.arange(0.0, 4.0, 0.1), 6.1),  # it ended
        (np.arange(4.0, 10.0, 0.1), 4.0),  # it began late
        (np.arange(0.4, 10.0, 1.0), 0.0),  # seldom, but all the time
        (np.array([]), 0.0),
    ],
)
def test_samples_are_missing_where_they_come_more_often_elsewhere(time, lost):
    assert missing(time, 0.0, 10.0) == pytest.approx(lost)
