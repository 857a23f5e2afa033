"""Values of arguments: what fits, and what does not."""

from argparse import ArgumentTypeError
from pathlib import Path

import pytest

from tricycle_cli.argument_types import (
    at_least,
    file_ending_in,
    namespace,
    nonnegative_number,
    parse_assignments,
    real_time_factor,
)
from tricycle_core.errors import PlanError


@pytest.mark.parametrize(
    ("value", "good", "bad"),
    [
        (at_least(0), {"0": 0, "12": 12}, ["-1", "1.5", "\u0663", ""]),
        (file_ending_in(".png", ".svg"), {"a/b.svg": Path("a/b.svg")}, ["b.gif", "png", ".png"]),
        (real_time_factor, {"0": 0.0, "2.5": 2.5, "1000": 1000.0}, ["-1", "1001", "nan", "fast"]),
        (namespace, {n: n for n in ("", "one", "/yard/one")}, ["/x/", "a b", "9x", "\u00e4"]),
        (nonnegative_number, {"0": 0.0, "1e3": 1000.0}, ["-1", "inf", "nan", "much"]),
    ],
)
def test_values_are_checked(value, good, bad):
    assert {text: value(text) for text in good} == good
    for text in bad:
        with pytest.raises(ArgumentTypeError):
            value(text)


def test_assignments_give_numbers_by_name():
    assert parse_assignments(["a=1", "b=-2e3"]) == {"a": 1.0, "b": -2000.0}
    with pytest.raises(PlanError, match="a is given twice"):
        parse_assignments(["a=1", "a=2"])
    with pytest.raises(PlanError, match="'a': needs name=number"):
        parse_assignments(["a"])
