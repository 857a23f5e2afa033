"""The chi-square distribution against SciPy's."""

import pytest
from scipy.stats import chi2

from parameter_identification.estimation import chi_square


@pytest.mark.parametrize("degrees", [1, 2, 7.5, 20])
def test_quantiles_and_tails_are_those_of_scipy(degrees):
    for probability in (0.05, 0.5, 0.95, 0.999):
        value = chi_square.quantile(probability, degrees)
        assert value == pytest.approx(float(chi2.ppf(probability, degrees)), rel=1e-12)
        assert chi_square.tail(value, degrees) == pytest.approx(1.0 - probability, rel=1e-9)
    assert chi_square.tail(0.0, degrees) == 1.0
