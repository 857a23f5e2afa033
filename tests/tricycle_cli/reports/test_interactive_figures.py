"""Interactive figures show the numbers that they are made of."""

import dataclasses

import numpy as np

from excitation_planner.plan import SearchHistory
from parameter_identification.drives.recorded import JointStates
from parameter_identification.identification_file import IdentificationDocument
from tricycle_cli.reports import interactive_figures
from tricycle_cli.reports.figure_files import matplotlib_figure
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
    assert [trace.name for trace in figure.data] == ["tried"] * 3 + ["the plan"]
    assert [axis.title.text for axis in figure.select_xaxes()] == ["a", "b", "c"]


def test_joints_of_messages_of_their_own_are_lines_without_gaps():
    none, time = np.full(4, np.nan), np.arange(4.0)
    angle, rate = np.array([0.1, np.nan, 0.2, np.nan]), np.array([np.nan, 3.0, np.nan, 4.0])
    figure = interactive_figures.commands(None, JointStates(time, angle, rate, none))
    steering, wheel = figure.data
    np.testing.assert_array_equal([steering.x, steering.y], [[0.0, 2.0], [0.1, 0.2]])
    np.testing.assert_array_equal([wheel.x, wheel.y], [[1.0, 3.0], [3.0, 4.0]])


def test_maneuvers_without_a_cost_are_drawn_above_the_others(plan):
    search = SearchHistory(np.eye(3), np.array([1.0, np.inf, 4.0]))
    wide = dataclasses.replace(plan, operation={"a": 0.1, "b": 0.2, "c": 0.3}, search=search)
    tried, left_out, *_ = interactive_figures.search_path(wide, search).data
    assert list(tried.x) == [1.0, 0.0]
    assert list(left_out.x) == [0.0]
    assert left_out.y[0] > max(tried.y)


def test_all_maneuvers_tried_lie_within_the_axes_of_the_file(plan):
    drawn = matplotlib_figure(interactive_figures.search_path(plan, plan.search))
    axes = drawn.axes[0]
    low, high = np.transpose([axes.get_xlim(), axes.get_ylim()])
    assert np.all((plan.search.x > low) & (plan.search.x < high))


def test_a_profile_is_drawn_as_it_was_computed(identified):
    found = decode(IdentificationDocument, identified, "identification", IdentificationError)
    (figure,) = interactive_figures.profiles(found)
    (curve,) = figure.data
    assert list(curve.y) == [3.8, 0.0, 3.8]
