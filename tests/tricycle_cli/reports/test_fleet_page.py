"""The page of a fleet: how it writes numbers."""

import pytest

from tricycle_cli.reports.fleet_page import _days


@pytest.mark.parametrize(
    ("days", "text"), [(0.0, "0"), (0.0123, "0.0123"), (9.99, "9.99"), (30.4, "30"), (1500, "1500")]
)
def test_days_are_written_without_an_exponent(days, text):
    assert _days(86400.0 * days) == text
