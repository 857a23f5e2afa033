"""The store of a study where two processes run one design, each with chunks of its maneuvers."""

import numpy as np
import pytest

from excitation_planner.box import Box
from excitation_planner.design.criteria import Criterion
from excitation_planner.design.noise import TrajectoryNoise
from excitation_planner.design.problem import DesignProblem, Search
from excitation_planner.design.store import Store
from tricycle_core.errors import DesignError

X = np.array([0.5])
FIRST, SECOND = range(10), range(10, 20)


@pytest.fixture(params=[Criterion.H, Criterion.C])
def stores(request, tmp_path):
    """Two processes' views of one store, and outputs of ten samples; both know the maneuver."""
    problem = DesignProblem(
        operation=Box.of({"v": (0.0, 1.0)}),
        unknown=Box.of({"a": (0.0, 1.0), "b": (0.0, 1.0)}),
        target="a",
        criterion=request.param,
        noise_variance=0.0,
        trajectory_noise=TrajectoryNoise(),
        samples=20,
        draws=20,
        budget=100_000,
        seed=0,
        search=Search.ADAPTIVE,
    )
    stores = [Store.of(tmp_path, problem) for _ in range(2)]
    for store in stores:
        store.number(X, verification=False)
    shape = (10,) if request.param is Criterion.H else (10, 3, 2)
    return *stores, (np.arange(float(np.prod(shape))).reshape(shape),)


def test_a_chunk_that_is_infeasible_for_another_process_decides(stores):
    one, other, outputs = stores
    one.keep(X, FIRST, outputs, verification=False)
    other.keep(X, SECOND, "too\nfast", verification=False)
    one.refresh()
    for store in (one, other, Store.open(one.path)):
        assert store.recall(X, verification=False) == "too fast"
        assert store.recall(X, FIRST, verification=False) == "too fast"
        assert store.missing(0, verification=False) == []


def test_outputs_of_what_another_process_found_infeasible_are_left_out(stores):
    one, other, outputs = stores
    one.keep(X, FIRST, "too fast", verification=False)
    before = (one.path / "results.csv").read_bytes()
    other.keep(X, SECOND, outputs, verification=False)
    other.keep(X, SECOND, "too slow", verification=False)  # the first reason stays
    assert (one.path / "results.csv").read_bytes() == before
    assert other.recall(X, verification=False) == "too fast"


def test_an_infeasible_chunk_after_kept_ones_is_not_simulated_again(stores):
    one, _, outputs = stores
    one.keep(X, FIRST, outputs, verification=False)
    one.keep(X, SECOND, "too fast", verification=False)
    again = Store.open(one.path)
    assert again.recall(X, SECOND, verification=False) == "too fast"
    again.add([], {0: "too fast"})  # told once more
    with pytest.raises(DesignError, match="is infeasible already: too fast"):
        again.add([], {0: "too slow"})


def test_outputs_that_contradict_another_process_are_refused(stores):
    one, other, outputs = stores
    one.keep(X, FIRST, outputs, verification=False)
    other.keep(X, FIRST, outputs, verification=False)
    with pytest.raises(DesignError, match=r"point 0, sample 0 has the output .* already"):
        other.keep(X, FIRST, (outputs[0] + 1.0,), verification=False)


def test_a_reason_without_a_word_is_refused(stores):
    one, _, _ = stores
    with pytest.raises(DesignError, match="say why it is infeasible"):
        one.keep(X, FIRST, " ", verification=False)
