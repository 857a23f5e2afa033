"""Interactive figures show the numbers that they are made of."""

import dataclasses

import numpy as np

from excitation_planner.plan import SearchHistory
from parameter_identification.identification_file import IdentificationDocument
from tricycle_cli.reports import interactive_figures
from tricycle_core.documents import decode
from tricycle_core.errors import IdentificationError


def test_figures_show_the_numbers_of_the_plan(plan):
    main_index, total = interactive_figures.indices(plan).data
    assert main_index.name == "main index S"
    assert list(main_index.x) == [index.value for index in plan.main.values()]
    assert list(total.error_x.array) == [i.high - i.value for i in plan.total.values()]
    traces = {
        trace.name: trace for trace in interactive_figures.search_path(plan, plan.search).data
    }
    assert list(traces["best so far"].x) == [2.5, 3.0, 2.5, 3.0]  # costs 3, 2, 1.5, 1
    assert list(traces["cannot be driven"].x) == [4.0]


def test_a_search_over_three_parameters_is_drawn_over_each(plan):
    search = SearchHistory(np.random.default_rng(0).random((5, 3)), np.arange(1.0, 6.0))
    wide = dataclasses.replace(plan, operation={"a": 0.1, "b": 0.2, "c": 0.3}, search=search)
    figure = interactive_figures.search_path(wide, search)
    assert len(figure.data) == 3
    assert [axis.title.text for axis in figure.select_xaxes()] == ["a", "b", "c"]


def test_a_profile_is_drawn_as_it_was_computed(identified):
    found = decode(IdentificationDocument, identified, "identification", IdentificationError)
    (figure,) = interactive_figures.profiles(found)
    (curve,) = figure.data
    assert list(curve.y) == [3.8, 0.0, 3.8]
