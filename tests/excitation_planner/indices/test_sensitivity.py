"""First stage against exactly known indices."""

import numpy as np
import pytest

from excitation_planner import Infill, monte_carlo_indices, sensitivity
from excitation_planner.box import Box
from excitation_planner.design.evaluation import cost_interval
from excitation_planner.indices.analytic import (
    ISHIGAMI_UNKNOWN,
    MATH_MODEL_UNKNOWN,
    g_function,
    g_function_indices,
    ishigami,
    ishigami_indices,
    math_model,
    quadrature_indices,
)
from excitation_planner.indices.kriging import Kriging
from excitation_planner.indices.sampling import sobol_sequence
from excitation_planner.indices.sensitivity import sensitivity_of_outputs
from excitation_planner.indices.sobol import sobol_indices
from tricycle_core.errors import DesignError

TABLE_1 = np.array([-2.0, -0.5, -2.0, -0.5])


def largest_error(result, exact):
    return max(np.abs(result.main - exact.main).max(), np.abs(result.total - exact.total).max())


def test_quadrature_gives_the_papers_table_1():
    exact = quadrature_indices(lambda P: math_model(TABLE_1, P), MATH_MODEL_UNKNOWN)
    assert np.allclose(exact.main, [0.0033, 0.0033, 0.2063, 0.2063], atol=5e-5)
    assert np.allclose(exact.total, [0.5798, 0.5798, 0.2220, 0.2220], atol=5e-5)


def test_quadrature_agrees_with_the_closed_form_of_ishigami():
    assert largest_error(quadrature_indices(ishigami, ISHIGAMI_UNKNOWN), ishigami_indices()) < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_math_model_with_300_samples(seed):
    exact = quadrature_indices(lambda P: math_model(TABLE_1, P), MATH_MODEL_UNKNOWN)
    result = sensitivity(
        lambda P: math_model(TABLE_1, P), MATH_MODEL_UNKNOWN, samples=300, seed=seed
    )
    assert largest_error(result, exact) < 6e-4
    assert result.variance == pytest.approx(exact.variance, rel=1e-3)
    assert result.leave_one_out_q2 > 0.999
    assert result.simulations == 300
    assert np.all(result.main_interval[:, 0] <= result.main)
    assert np.all(result.main <= result.main_interval[:, 1])


@pytest.mark.slow
def test_metamodel_predicts_in_the_users_units():
    result = sensitivity(ishigami, ISHIGAMI_UNKNOWN, samples=400)
    P = ISHIGAMI_UNKNOWN.from_unit(np.random.default_rng(0).uniform(size=(100, 3)))
    assert np.allclose(result.predict(P), ishigami(P), atol=0.1)


@pytest.mark.slow
def test_ishigami_with_400_samples():
    result = sensitivity(ishigami, ISHIGAMI_UNKNOWN, samples=400)
    assert largest_error(result, ishigami_indices()) < 2e-3


@pytest.mark.slow
def test_more_than_six_parameters():
    """A function of 20 parameters, with interactions; exact by its own closed form."""
    k = 20
    weight = 1.0 / np.arange(1, k + 1)

    def f(P):
        return P @ weight + P[:, 0] * P[:, 1]

    # variances of p_i (w_i + 1/2) for the two that interact, w_i p_i for the rest, and 1/144
    slope = weight + np.r_[0.5, 0.5, np.zeros(k - 2)]
    variance = np.sum(slope**2) / 12 + 1 / 144
    main = slope**2 / 12 / variance
    total = main + np.r_[1, 1, np.zeros(k - 2)] / 144 / variance
    result = sensitivity(f, {f"p{i}": (0.0, 1.0) for i in range(k)}, samples=200)
    assert np.allclose(result.main, main, atol=2e-3)
    assert np.allclose(result.total, total, atol=2e-3)


def test_g_function_is_hard_but_ranked_rightly():
    a = np.array([0.0, 1.0, 4.5, 9.0])
    box = {f"p{i}": (0.0, 1.0) for i in range(4)}
    result = sensitivity(lambda P: g_function(P, a), box, samples=300)
    assert largest_error(result, g_function_indices(a)) < 0.05
    assert np.array_equal(np.argsort(-result.main), [0, 1, 2, 3])


@pytest.mark.slow
@pytest.mark.parametrize("infill_by", Infill)
@pytest.mark.parametrize("batch", [5, 8])
def test_infill_helps(infill_by, batch):
    exact = ishigami_indices()
    before = sensitivity(ishigami, ISHIGAMI_UNKNOWN, samples=100)
    after = sensitivity(
        ishigami, ISHIGAMI_UNKNOWN, samples=100, infill=20, infill_by=infill_by, batch=batch
    )
    assert after.simulations == 120
    assert largest_error(after, exact) < largest_error(before, exact)


@pytest.mark.slow
def test_failed_simulations_are_counted_and_left_out():
    counted = 0

    def f(P):
        nonlocal counted
        m = ishigami(P)
        m[3::50] = np.nan
        m[7] = np.inf
        counted += int(np.sum(~np.isfinite(m)))
        return m

    result = sensitivity(f, ISHIGAMI_UNKNOWN, samples=400)
    assert (result.simulations, result.failed) == (400, counted)
    assert counted > 8
    assert largest_error(result, ishigami_indices()) < 5e-3


@pytest.mark.slow
def test_the_last_third_of_the_samples_goes_where_the_indices_gain():
    """The box is filled first, then f is called once more."""
    errors = []
    rng = np.random.default_rng(0)
    for seed in range(6):
        x = rng.uniform(-5.0, 0.0, size=4)
        exact = quadrature_indices(lambda P, x=x: math_model(x, P), MATH_MODEL_UNKNOWN, nodes=14)
        calls = []

        def f(P, x=x, calls=calls):
            calls.append(len(P))
            return math_model(x, P)

        errors.append(largest_error(sensitivity(f, MATH_MODEL_UNKNOWN, seed=seed), exact))
        assert calls == [133, 67]
    assert np.median(errors) < 5e-4
    assert max(errors) < 2e-3


def test_an_output_that_differs_in_one_sample_has_wide_intervals():
    U = sobol_sequence(20, 2)
    result = sensitivity_of_outputs(Box.of({"p1": (0, 1), "p2": (0, 1)}), U, np.eye(20)[0])
    assert [fold.variance == 0.0 for fold in result.folds] == [True, False, False, False, False]
    assert np.all(np.ptp(result.total_interval, axis=1) > 0.2)
    assert cost_interval(result, 0) == (0.0, np.inf)


def test_fewer_samples_than_folds_are_left_out_one_by_one():
    result = sensitivity(lambda P: P[:, 0] ** 2, {"p": (0.0, 1.0)}, samples=3)
    assert len(result.folds) == 3


def test_one_parameter_has_all_the_variance():
    result = sensitivity(lambda P: np.exp(P[:, 0]), {"p": (0.0, 1.0)}, samples=20)
    assert result.main == pytest.approx([1.0])
    assert result.total == pytest.approx([1.0])


@pytest.mark.parametrize(
    ("f", "arguments", "message"),
    [
        (lambda P: np.ones(len(P)), {}, "the output is constant"),
        (lambda P: P[:, 0], {"samples": 4}, "samples = 4: 3 unknown parameters need 5"),
        (lambda P: np.full(len(P), np.nan), {}, "133 of 133 simulations failed"),
        (lambda P: P, {}, r"shape \(133, 3\)"),
        (lambda P: 1.0, {}, r"shape \(\)"),
        (lambda P: P[:, 9], {}, "f raised IndexError: index 9 is out of bounds"),
        (ishigami, {"infill": 3, "batch": 0}, "batch = 0"),
    ],
)
def test_mistakes_are_named(f, arguments, message):
    with pytest.raises(DesignError, match=message):
        sensitivity(f, ISHIGAMI_UNKNOWN, **arguments)


def test_monte_carlo_converges_to_the_exact_indices():
    exact = quadrature_indices(lambda P: math_model(TABLE_1, P), MATH_MODEL_UNKNOWN)
    result = monte_carlo_indices(lambda U: math_model(TABLE_1, U), 4, samples=2**15)
    assert largest_error(result, exact) < 0.05
    assert result.variance == pytest.approx(exact.variance, rel=1e-2)


def test_masked_outputs_are_failed_simulations():
    box = {"p": (0.0, 1.0), "q": (0.0, 1.0)}

    def f(P):
        return np.where(P[:, 0] < 0.2, 1e3, P[:, 0] + 0.3 * P[:, 1])

    masked = sensitivity(lambda P: np.ma.masked_greater(f(P), 100.0), box, samples=20)
    failed = sensitivity(lambda P: np.where(f(P) > 100.0, np.nan, f(P)), box, samples=20)
    assert masked.failed == failed.failed > 0
    assert np.array_equal(masked.main, failed.main)


def test_wrong_outputs_and_infills_are_named():
    box = {"p": (0.0, 1.0), "q": (0.0, 1.0)}
    with pytest.raises(DesignError, match="not complex128"):
        sensitivity(lambda P: P[:, 0] + 1j, box, samples=20)
    with pytest.raises(DesignError, match="unknown infill 'most'; one of: 'largest-variance', "):
        sensitivity(lambda P: P[:, 0], box, samples=20, infill=5, infill_by="most")
    by_name, by_member = (
        sensitivity(lambda P: P[:, 0] + P[:, 1] ** 2, box, samples=12, infill=5, infill_by=by)
        for by in ("index-variance", Infill.INDEX_VARIANCE)
    )
    assert np.array_equal(by_name.main, by_member.main)


@pytest.mark.parametrize(("waves", "samples"), [(5, 100), (12, 300)])
def test_waves_along_one_parameter_are_not_taken_for_noise(waves, samples):
    result = sensitivity(
        lambda P: np.sin(2 * np.pi * waves * P[:, 0]) + P[:, 1],
        {"a": (0, 1), "b": (0, 1)},
        samples=samples,
    )
    assert result.main == pytest.approx([6 / 7, 1 / 7], abs=1e-4)


def test_noise_of_the_output_is_no_interaction_of_parameters_that_do_not_act():
    rng = np.random.default_rng(5)
    result = sensitivity(
        lambda P: P[:, 0] + 0.3 * rng.standard_normal(len(P)),
        {"a": (0, 1), "b": (0, 1), "c": (0, 1)},
        samples=200,
    )
    assert result.main[0] > 0.95
    assert result.total[1:].max() < 0.05
    assert 0.2 < result.unexplained < 0.8


# narrower intervals, e.g. by a quarter of what the folds change, do not hold as many
@pytest.mark.parametrize(("samples", "share"), [(12, 0.95), (20, 0.85), (40, 0.88)])
def test_intervals_from_few_samples_hold_the_indices(samples, share):
    exact, held = ishigami_indices(), []
    for seed in range(8):
        result = sensitivity(ishigami, ISHIGAMI_UNKNOWN, samples=samples, seed=seed)
        for interval, index in (
            (result.main_interval, exact.main),
            (result.total_interval, exact.total),
        ):
            held += ((interval[:, 0] <= index) & (index <= interval[:, 1])).tolist()
    assert np.mean(held) > share


def test_the_indices_of_a_rough_metamodel_hold_all_of_its_variance():
    rng = np.random.default_rng(0)
    rough = Kriging().fit_process(
        *(rng.random((200, 2)), rng.standard_normal(200)),
        length_scale=np.full(2, 0.06),
        amplitude=np.zeros((2, 2)),
        nugget=1e-6,
    )
    exact = np.var(rough.predict(sobol_sequence(2**14, 2, seed=1)))
    assert sobol_indices(rough).variance == pytest.approx(exact, rel=1e-3)


def test_an_output_that_moves_in_a_corner_only_is_not_called_constant():
    result = sensitivity(
        lambda P: np.maximum(0.0, P.sum(axis=1) - 2.7),
        {"a": (0, 1), "b": (0, 1), "c": (0, 1)},
        samples=200,
    )
    assert result.total.min() > 0.5


@pytest.mark.parametrize(
    ("f", "arguments", "message"),
    [
        (lambda P: P[:, 0], {"seed": -1}, "seed = -1: must be a whole number"),
        (lambda P: P[:, 0], {"seed": None}, "seed = None: must be a whole number"),
        (lambda P: 1e200 * P[:, 0], {}, "an output is .*e.199: 1e.150 at most"),
        (lambda P: 1e-200 * P[:, 0], {}, "the outputs differ by .*e-201: 1e-150 at least"),
        (lambda P: [None] * len(P), {}, "real numbers, NaN where it failed; not object"),
    ],
)
def test_what_no_index_can_be_computed_from_is_named(f, arguments, message):
    with pytest.raises(DesignError, match=message):
        sensitivity(f, {"a": (0, 1)}, samples=20, **arguments)
