"""A search for a route is given up when another one is wanted, or none any more."""

import math
from concurrent.futures import CancelledError

import numpy as np
import pytest

from excitation_planner.way_back.route import RouteRequest, find_route
from excitation_planner.way_back.search import RouteSearch
from tricycle_core.errors import PlanError

PATIENCE = 60.0  # s; only a failing test waits that long
ALLEY = (np.array([[0.0, 0.0], [25.0, 0.0], [25.0, 3.0], [0.0, 3.0]]),)
FOOTPRINT = np.array([[1.8, 0.5], [1.8, -0.5], [-0.4, -0.5], [-0.4, 0.5]])
LONG = RouteRequest((6.0, 1.5, 0.0), (15.0, 1.5, math.pi), 3.0, ALLEY, FOOTPRINT)
"""There is no room to turn: seconds of search."""
SHORT = RouteRequest((0.0, 0.0, 0.0), (0.0, 1.0, math.pi), 3.0)


@pytest.fixture
def search():
    with RouteSearch() as search:
        yield search


def test_an_outdated_search_makes_way_for_the_next(search):
    assert search.route(LONG) is None
    outdated = search._route
    assert search.route(SHORT) is None
    with pytest.raises((PlanError, CancelledError), match=r"abandoned|^$"):
        outdated.result(PATIENCE)
    newest = search._route
    newest.result(PATIENCE)
    assert search.route(SHORT) == find_route(SHORT)
    assert search._route is newest  # of one request there is one search


@pytest.mark.parametrize("end", [RouteSearch.close, lambda search: search.route(None)])
def test_what_nobody_waits_for_ends(search, end):
    search.route(LONG)
    running = search._route
    end(search)
    with pytest.raises((PlanError, CancelledError), match=r"abandoned|^$"):
        running.result(PATIENCE)


def test_that_there_is_none_is_told(search):
    none = RouteRequest((6.0, 1.0, 0.0), (15.0, 1.5, 0.0), 3.0, ALLEY, FOOTPRINT + 5.0)
    search.route(none)
    search._route.exception(PATIENCE)
    with pytest.raises(PlanError, match="the vehicle is not"):
        search.route(none)
