"""Boxes with names on their axes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from excitation_planner.box import Box
from tricycle_core.errors import DesignError


def test_order_of_names_is_kept():
    box = Box.of({"b": (0, 1), "a": (-2, 3)})
    assert box.names == ("b", "a")
    assert box.index("a") == 1
    assert len(box) == 2
    assert Box.of(box.bounds()) == box
    assert Box.of(box) is box


@given(
    st.floats(-1e6, 1e6),
    st.floats(1e-3, 1e6),
    st.lists(st.floats(0, 1), min_size=1, max_size=5),
)
def test_unit_box_and_back(low, width, units):
    box = Box.of({"p": (low, low + width)})
    U = np.array(units)[:, None]
    P = box.from_unit(U)
    assert np.all((box.low[0] <= P) & (box.high[0] >= P))
    assert np.allclose(box.to_unit(P), U, atol=1e-6)


@pytest.mark.parametrize(
    ("bounds", "message"),
    [
        ({}, "at least one parameter"),
        ({"p": (1.0, 0.0)}, r"p: range \(1, 0\) must be finite with low < high"),
        ({"p": (1.0, 1.0)}, "low < high"),
        ({"p": (0.0, float("nan"))}, "finite"),
        ({"p": (0.0, float("inf"))}, "finite"),
        ({"p": (0.0,)}, r"p: a range is \(low, high\)"),
        ({"p": ("low", "high")}, r"p: a range is \(low, high\), not \('low', 'high'\)"),
    ],
)
def test_impossible_boxes_are_refused(bounds, message):
    with pytest.raises(DesignError, match=message):
        Box.of(bounds)


def test_a_name_given_twice_is_refused():
    with pytest.raises(DesignError, match="twice"):
        Box(("p", "p"), (0.0, 0.0), (1.0, 1.0))
