"""What a profile finds besides its interval."""

import numpy as np
import pytest

from parameter_identification.estimation.levenberg_marquardt import Fit
from parameter_identification.estimation.profiles import profile

STD = 0.05


class OtherValley:
    """A parabola around 0.5, and beyond 0.56 another valley."""

    n, k = 2, 1

    def __init__(self, depth):
        self.depth = depth

    def minimise(self, start, free, *, tolerance):
        below = self.depth if start[0] > 0.56 else 0.0
        return Fit(start, 100.0 + ((start[0] - 0.5) / STD) ** 2 - below)


@pytest.mark.parametrize("depth", [0.0, 40.0])
def test_a_point_below_the_estimate_is_told(depth):
    best = Fit(np.array([0.5, 0.0]), 100.0)
    curve = profile(OtherValley(depth), best, np.diag([STD**2, 1.0]), 0, 0.95)
    if not depth:
        assert curve.lower is None
        assert curve.interval == pytest.approx((0.402, 0.598), abs=1e-3)
        return
    assert curve.lower is not None
    assert curve.lower.at[0] > 0.56
    assert curve.lower.cost < 70.0


@pytest.mark.parametrize("std", [STD, 0.01])  # however far the ends are
def test_an_interval_that_the_cost_does_not_limit_is_the_whole_range(std):
    class Flat(OtherValley):
        def minimise(self, start, free, *, tolerance):
            return Fit(start, 100.0 + 0.01 * (start[0] - 0.5) ** 2)

    best = Fit(np.array([0.5, 0.0]), 100.0)
    curve = profile(Flat(0.0), best, np.diag([std**2, 1.0]), 0, 0.95)
    assert curve.interval == (0.0, 1.0)
    assert (curve.z[0], curve.z[-1]) == (0.0, 1.0)


@pytest.mark.parametrize(("lost", "high"), [(0.6, 0.598), (1.0, 1.0)])
def test_a_point_at_which_the_search_was_given_up_does_not_end_an_interval(lost, high):
    class GivenUp(OtherValley):
        def minimise(self, start, free, *, tolerance):
            fit = super().minimise(start, free, tolerance=tolerance)
            within = 0.5 < start[0] <= lost
            return Fit(fit.at, 200.0, converged=False) if within else fit

    best = Fit(np.array([0.5, 0.0]), 100.0)
    curve = profile(GivenUp(0.0), best, np.diag([STD**2, 1.0]), 0, 0.95)
    assert curve.interval == pytest.approx((0.402, high), abs=2e-3)
