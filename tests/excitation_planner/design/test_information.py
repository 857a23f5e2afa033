"""Fisher information against linear models, where everything is known in closed form."""

import numpy as np
import pytest

from excitation_planner import (
    Box,
    BoxPrior,
    Criterion,
    ManeuverSet,
    TrajectoryNoise,
    Verdict,
    design_excitation,
)
from excitation_planner.design.evaluation import judge_outcome, parameter_points
from excitation_planner.design.information import (
    difference_points,
    information,
    information_costs,
    posterior_covariance,
)
from excitation_planner.design.problem import DesignProblem, Search
from tricycle_core.errors import DesignError

TIME = np.arange(40) * 0.05
UNIT = {"p": (0.0, 1.0), "q": (0.0, 1.0)}


def linear(P):
    """Channels x = p t, y = q t²: (n, 40, 2)."""
    return np.stack([P[:, :1] * TIME, P[:, 1:] * TIME**2], axis=-1)


def information_of(noise):
    U = difference_points(2, 4, seed=0)
    return information(U, linear(U), noise)


def test_white_noise_in_closed_form():
    F = information_of(TrajectoryNoise(std=(0.1, 0.2)))
    exact = np.diag([np.sum(TIME**2) / 0.1**2, np.sum(TIME**4) / 0.2**2])
    assert F.shape == (4, 2, 2)
    assert np.allclose(F, exact, rtol=1e-6, atol=1e-6 * exact.max())


def test_differences_stay_in_the_box():
    U = difference_points(2, 4096, seed=0)
    assert U.min() >= 0.0
    assert U.max() <= 1.0


def judged(f, *, verification):
    """What is found out about a maneuver with the criterion C for p."""
    problem = DesignProblem(
        operation=Box.of({"x": (0.0, 1.0)}),
        unknown=Box.of(UNIT),
        target="p",
        criterion=Criterion.C,
        noise_variance=0.0,
        trajectory_noise=TrajectoryNoise(std=0.1),
        samples=40,
        draws=16,
        budget=10_000,
        seed=0,
        search=Search.ADAPTIVE,
    )
    U = parameter_points(problem, verification=verification)
    return judge_outcome(problem, np.zeros(1), U, (f(U),), verification=verification)


def test_the_interval_of_c_is_that_of_the_mean_of_the_draws():
    """x = (1 + p)² t: of one vehicle the information about p is 4 (1 + p)² sum(t²)/std²."""
    found = judged(lambda P: ((1.0 + P[:, :1]) ** 2 * TIME)[..., None], verification=False)
    p = difference_points(2, 16, seed=0)[::3, 0]
    variance = 1.0 / (12.0 + 4.0 * (1.0 + p) ** 2 * np.sum(TIME**2) / 0.1**2)
    half = 1.96 * variance.std() / 4.0
    assert found.evaluation.cost == pytest.approx(variance.mean(), rel=0.01)
    assert found.cost_interval == pytest.approx(
        (variance.mean() - half, variance.mean() + half), rel=0.02
    )


def test_the_indices_beside_c_are_those_of_the_squared_deviation_from_the_middle():
    """x = (p + 0.6 q) t: of u² + 1.2 u v + 0.36 v², with u and v from -1/2 to 1/2."""
    moved = judged(lambda P: (P @ [1.0, 0.6])[:, None, None] * TIME[:, None], verification=True)
    alone, both = np.array([1.0, 0.6**4]) / 180.0, 1.2**2 / 144.0
    assert callable(moved.sensitivity)
    found, variance = moved.sensitivity(), alone.sum() + both
    assert found.main == pytest.approx(alone / variance, abs=1e-3)
    assert found.total == pytest.approx((alone + both) / variance, abs=1e-3)
    assert found.variance == pytest.approx(variance * np.mean(TIME**2) ** 2, rel=1e-3)


def test_drift_is_generalised_least_squares():
    F = information_of(TrajectoryNoise(std=0.1, drift_std=0.3, drift_time=2.0, period=0.05))
    lag = np.abs(TIME[:, None] - TIME)
    C = 0.1**2 * np.eye(40) + 0.3**2 * np.exp(-lag / 2.0)
    assert F[0, 0, 0] == pytest.approx(TIME @ np.linalg.solve(C, TIME), rel=1e-6)


def test_an_unknown_start_pose_is_marginalised():
    noise = TrajectoryNoise(std=0.1, start_position_std=0.5, start_heading_std=0.2)
    U = difference_points(2, 1, seed=0)
    F = information(U, linear(U), noise)[0]
    # the same by the covariance of everything, inverted as a whole
    p, q = U[0]
    ones, zeros = np.ones(40), np.zeros(40)
    J_x = np.stack([TIME, zeros, ones, zeros, -q * TIME**2], axis=1)
    J_y = np.stack([zeros, TIME**2, zeros, ones, p * TIME], axis=1)
    J = np.vstack([J_x, J_y]) / 0.1
    whole = J.T @ J + np.diag([0, 0, 0.5**-2, 0.5**-2, 0.2**-2])
    assert np.allclose(np.linalg.inv(np.linalg.inv(whole)[:2, :2]), F, rtol=1e-5)
    assert np.all(
        np.linalg.eigvalsh(information(U, linear(U), TrajectoryNoise(std=0.1))[0] - F) > 0
    )


def test_without_information_the_prior_remains():
    covariance = posterior_covariance(np.zeros((1, 3, 3)))
    assert np.allclose(covariance[0], np.eye(3) / 12)
    assert information_costs(covariance, Criterion.C, 1) == pytest.approx([1 / 12])
    assert information_costs(covariance, Criterion.A, None) == pytest.approx([3 / 12])
    assert information_costs(covariance, Criterion.D, None) == pytest.approx([-3 * np.log(12)])


def _mix(x, P):
    """The direction x of a step decides how much p and q move the end."""
    moved = np.cos(x[0]) * P[:, :1] + np.sin(x[0]) * P[:, 1:]
    return np.stack([moved * TIME, 0 * moved * TIME], axis=-1)


def design(f, target, criterion, operation=None, **arguments):
    return design_excitation(
        f,
        operation or {"angle": (-0.5, 1.0)},
        UNIT,
        target,
        **{"criterion": criterion, "draws": 4, "budget": 800, "samples": 20, "workers": 1}
        | arguments,
    )


@pytest.mark.slow
def test_c_design_for_one_parameter():
    result = design(_mix, "p", Criterion.C)
    # best at angle 0, where q does not disturb: information sum(t²)/σ², prior 12
    assert result.x[0] == pytest.approx(0.0, abs=0.02)
    assert result.cost == pytest.approx(1 / (np.sum(TIME**2) / 0.01**2 + 12), rel=0.05)
    assert result.verdict is Verdict.EXCITES
    assert result.main[0] > 0.9
    other = design(_mix, "q", Criterion.C)
    assert other.x[0] == pytest.approx(1.0, abs=0.02)


def test_a_drive_that_teaches_nothing_is_called_so():
    result = design(_mix, "q", Criterion.C, {"angle": (-1e-3, 1e-3)})
    assert result.verdict is Verdict.CANNOT_EXCITE
    assert "of the prior deviation of q" in result.explanation


@pytest.mark.slow
@pytest.mark.parametrize("criterion", [Criterion.D, Criterion.A])
def test_two_drives_learn_what_one_cannot(criterion):
    one = design(_mix, None, criterion)
    box = Box.of({"angle": (-0.5, 1.0)})
    pair = ManeuverSet((_mix, _mix), (box, box))
    assert pair.operation.names == ("1.angle", "2.angle")
    both = design(pair, None, criterion, pair.operation)
    assert one.verdict is Verdict.CANNOT_EXCITE
    assert both.verdict is Verdict.EXCITES
    assert both.cost < one.cost
    assert abs(both.x[0] - both.x[1]) == pytest.approx(1.5, abs=0.05)  # as different as can be


def test_the_run_in_the_middle_of_the_box_may_fail():
    def f(x, P):
        Y = _mix(x, P)
        Y[np.all(P == 0.5, axis=1)] = np.nan
        return Y

    found = design(f, "p", Criterion.C)
    assert found.failed > 0
    assert found.sensitivity.main[0] > 0.5


def test_a_maneuver_at_which_most_draws_fail_is_none():
    """Where it would be best, two thirds of the vehicles fail."""

    def f(x, P):
        Y = _mix(x, P)
        if x[0] < 0.3:
            Y[P[:, 1] > 0.33] = np.nan
        return Y

    found = design(f, "p", Criterion.C, draws=32, budget=8000)
    assert found.x[0] > 0.29


@pytest.mark.parametrize("criterion", [Criterion.C, Criterion.D, Criterion.A])
@pytest.mark.parametrize("std", [1e-8, 1e-10, 1e-12])
def test_what_rounding_makes_indefinite_is_refused(criterion, std):
    """Both parameters act alike."""

    def f(x, P):
        moved = (1.0 + x[0]) * P.sum(axis=1, keepdims=True) * TIME
        return np.stack([moved, 0.0 * moved], axis=-1)

    with pytest.raises(DesignError, match="lost in rounding"):
        design(f, "p", criterion, trajectory_noise=TrajectoryNoise(std=std))


def test_draws_with_failed_simulations_are_left_out():
    def f(x, P):
        Y = _mix(x, P)
        Y[5] = np.nan
        return Y

    assert design(f, "p", Criterion.C).failed > 0
    with pytest.raises(DesignError, match="simulations failed"):
        design(lambda x, P: _mix(x, P) * np.nan, "p", Criterion.C)


@pytest.mark.parametrize(
    ("target", "criterion", "f", "message"),
    [
        (None, Criterion.C, _mix, "criterion c needs a target: p, q"),
        (None, Criterion.H, _mix, "criterion h needs a target"),
        ("p", Criterion.C, lambda x, P: P[:, 0], "criterion c needs trajectories"),
    ],
)
def test_mistakes_are_named(target, criterion, f, message):
    with pytest.raises(DesignError, match=message):
        design(f, target, criterion)


def test_a_prior_adds_its_information_and_is_drawn_from():
    prior = BoxPrior(np.array([0.3, 0.6]), np.array([[1e-4, 5e-5], [5e-5, 4e-4]]))
    F = information_of(TrajectoryNoise(std=0.1))[:1]
    exact = np.linalg.inv(F[0] + np.linalg.inv(prior.covariance))
    assert np.allclose(posterior_covariance(F, prior)[0], exact, rtol=1e-9)
    drawn = difference_points(2, 4096, seed=0, prior=prior)[::3]
    assert np.allclose(drawn.mean(axis=0), prior.mean, atol=1e-4)
    assert np.allclose(np.cov(drawn.T), prior.covariance, rtol=0.02)


def test_a_measured_heading_turns_with_the_start_pose():
    """p turns path and heading as the start pose does: once that is said, little is left of p."""
    U = difference_points(2, 4, seed=0)
    Y = np.stack([0 * U[:, :1] + TIME, U[:, :1] * TIME, U[:, :1] + 0 * TIME], axis=-1)
    known, turned = (
        information(U, Y, TrajectoryNoise(0.1, start_heading_std=10.0, heading_channel=channel))
        for channel in (None, 2)
    )
    # dy/dp = t and dheading/dp = 1 are those of a turn of the start pose, up to its small dx
    assert turned[0, 0, 0] < 0.5 * known[0, 0, 0]


def test_unknown_delays_and_biases_are_marginalised():
    """Three channels on two clocks, the third with a bias: against the inverse of everything."""
    noise = TrajectoryNoise(std=(0.1, 0.1, 0.2), delay_std=0.3, bias_std=0.4)
    U = difference_points(2, 1, seed=0)
    P, t = U, TIME
    Y = np.stack([P[:, :1] * t, P[:, 1:] * t**2, P[:, :1] + P[:, 1:] * t], axis=-1)
    F = information(U, Y, noise)[0]
    (p, q), ones, zeros = U[0], np.ones(40), np.zeros(40)
    # columns p, q, delay of x and y, delay of the third, its bias
    J_x = np.stack([t, zeros, -p * ones, zeros, zeros], axis=1) / 0.1
    J_y = np.stack([zeros, t**2, -np.gradient(q * t**2, 0.05), zeros, zeros], axis=1) / 0.1
    J_z = np.stack([ones, t, zeros, -q * ones, ones], axis=1) / 0.2
    J = np.vstack([J_x, J_y, J_z])
    whole = J.T @ J + np.diag([0, 0, 0.3**-2, 0.3**-2, 0.4**-2])
    assert np.allclose(np.linalg.inv(F), np.linalg.inv(whole)[:2, :2], rtol=1e-5)
