"""What a notebook shows of results: short texts, tables and figures."""

import sys

import numpy as np
import pytest
from matplotlib.figure import Figure

from excitation_planner import design_excitation, sensitivity
from tricycle_core.errors import ReportError

UNKNOWN = {"stiffness": (0.0, 1.0), "damping": (0.0, 1.0)}


def simulate(x, P):
    return x[0] * P[:, 0] + (0.1 + x[-1] ** 2) * P[:, 1]


@pytest.fixture(scope="module")
def found():
    return sensitivity(lambda P: P[:, 0] + 0.5 * P[:, 1], UNKNOWN, samples=20)


@pytest.fixture(scope="module", params=[{"x": (0.0, 1.0)}, {"x": (0.0, 1.0), "y": (0.0, 1.0)}])
def design(request):
    arguments = {"samples": 10, "budget": 250, "workers": 1}
    return design_excitation(simulate, request.param, UNKNOWN, "stiffness", **arguments)


def axes():
    return Figure().add_subplot()


def test_indices_are_one_line_each(found):
    assert repr(found).count("\n") == 2
    assert "stiffness  S 0.800 (0.800 to 0.800)  ST 0.800" in repr(found)


def test_indices_as_a_table(found):
    pytest.importorskip("pandas")
    table = found.to_dataframe()
    assert list(table.index) == ["stiffness", "damping"]
    assert table.main["stiffness"] == pytest.approx(0.8, abs=1e-3)


def test_indices_as_a_figure(found):
    drawn = found.plot(axes())
    assert [label.get_text() for label in drawn.get_yticklabels()] == ["stiffness", "damping"]


def test_a_design_says_what_it_is_worth(design):
    text = repr(design)
    assert text.startswith("Design: excites stiffness, criterion h = ")
    assert f"at x {design.x[0]:.4g}" in text
    assert text.count("\n") == 2


def test_a_design_has_a_row_per_maneuver(design):
    pytest.importorskip("pandas")
    table = design.to_dataframe()
    assert len(table) == len(design.history)
    assert table.cost.min() == pytest.approx(min(e.cost for e in design.history))


def test_a_design_is_drawn_in_its_box(design):
    drawn = design.plot(axes())
    star = drawn.lines[-1]
    assert np.array_equal(star.get_xdata()[0], design.x[0])
    assert drawn.get_xlabel() == "x"


def test_a_library_that_is_missing_is_named(found, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ReportError, match="to_dataframe needs pandas: pip install pandas"):
        found.to_dataframe()
