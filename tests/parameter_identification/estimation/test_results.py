"""Results of an identification: what is derived from them."""

import dataclasses

import numpy as np
import pytest
from found_identification import FOUND
from matplotlib.figure import Figure

from parameter_identification.estimation.results import Combination, EffectEstimate


def test_arrays_are_in_the_order_of_the_names():
    assert FOUND.names == ("cornering_stiffness", "yaw_inertia")
    np.testing.assert_array_equal(FOUND.estimates, [600.0, 50.0])
    np.testing.assert_array_equal(FOUND.standard_deviations, [5.0, 7.0])
    np.testing.assert_array_equal(FOUND.intervals, [[590.0, 611.0], [40.0, 60.0]])
    np.testing.assert_allclose(FOUND.correlation, [[1.0, 1.0 / 35.0], [1.0 / 35.0, 1.0]])
    assert FOUND.identifiable == {"cornering_stiffness": True, "yaw_inertia": False}
    assert FOUND.white


def test_the_posterior_is_a_prior():
    prior = FOUND.posterior()
    assert prior.names == FOUND.names
    np.testing.assert_array_equal(prior.mean, FOUND.estimates)
    np.testing.assert_array_equal(prior.covariance, FOUND.covariance)


def test_combinations_are_read_by_people():
    assert str(Combination({"yaw_inertia": 0.98}, 0.9)) == "yaw_inertia"
    assert str(Combination({"a": 0.8, "b": -0.6}, 0.9)) == "+0.80 a -0.60 b"


def test_an_identification_is_a_line_per_parameter():
    assert repr(FOUND).splitlines() == [
        "Identification of tricycle from first; 95% intervals",
        "  cornering_stiffness  600 (590 to 611) N/rad",
        "  yaw_inertia          not shown",
    ]


def test_an_identification_as_a_table():
    pytest.importorskip("pandas")
    table = FOUND.to_dataframe()
    assert list(table.index) == ["cornering_stiffness", "yaw_inertia"]
    assert table.loc["cornering_stiffness", ["low", "high", "truth"]].to_list() == [590, 611, 601]
    assert not table.shown["yaw_inertia"]


def test_an_identification_as_a_figure():
    drawn = FOUND.plot(Figure().add_subplot())
    first, second = (label.get_text() for label in drawn.get_yticklabels())
    assert first.startswith("cornering stiffness\n500 to 1500 N/rad")
    assert "not shown" in second
    ratio = dataclasses.replace(FOUND.parameters["yaw_inertia"], unit="1")
    found = dataclasses.replace(FOUND, parameters=FOUND.parameters | {"yaw_inertia": ratio})
    drawn = found.plot(Figure().add_subplot())
    assert drawn.get_yticklabels()[1].get_text().endswith(" to 75")  # not "to 75 1"


def test_deviations_are_shown_where_chance_does_not_explain_them():
    effects = tuple(
        EffectEstimate(name, "1", 0.0, 0.001, 0.01, chance=chance)
        for name, chance in (
            ("turn deviation", 0.0051),
            ("speed deviation", 0.0049),
            ("zero", None),
        )
    )
    found = dataclasses.replace(FOUND, effects=effects)
    assert [e.name for e in found.deviations] == ["speed deviation"]  # 1 % for both together
    assert FOUND.deviations == ()
