"""Drives of a vehicle that contradict each other, by linear problems of a few measurements."""

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import binom
from simulated_drives import VEHICLE

from parameter_identification.estimation.interval_correction import (
    CONTRADICTING,
    heterogeneity_factors,
    student_factor,
)
from parameter_identification.estimation.shares import DriveShare, FitSetting
from parameter_identification.fleet_fit import FleetFit
from parameter_identification.many_drives import result_of
from parameter_identification.vehicle_fit import Variables, VehicleFit, _summed
from parameter_identification.vehicle_scatter import scatter_of
from tricycle_cli.reports.remarks import remarks_on_many

K, NOISE = len(VEHICLE.unknown), 0.01
REPEATS = 100


def vehicle(rng, values, *, rows=None, since=None):
    """A vehicle at its best fit to drives that measure values (d, k), or `rows` sums of each."""
    d, rates = len(values), 0 if since is None else 1
    ends = np.full(rates, np.inf)
    variables = Variables(
        np.append(np.zeros(K), -ends),
        np.append(np.ones(K), ends),
        np.append(np.full(K, 0.5), np.zeros(rates)),
        np.diag([*[12.0] * K, *[4.0] * rates]),
        tuple(range(rates)),
    )
    since = np.zeros(d) if since is None else since
    designs = [variables.of_drive(time) for time in since]
    shares = []
    for design, value in zip(designs, values, strict=True):
        J = (np.eye(K) if rows is None else rng.normal(size=(rows, K))) / NOISE
        at = design @ variables.mean
        r = J @ (at - value) + rng.normal(size=len(J))
        shares.append(
            DriveShare("", 0.0, 900, at, r @ r, J.T @ J, J.T @ r, np.empty(0), white=True, truth={})
        )
    here = _summed(variables, variables.mean, designs, shares)
    at = np.clip(here.minimum(), variables.low, variables.high)
    files = [Path(f"drive_{i}") for i in range(d)]
    return VehicleFit(files, FitSetting(VEHICLE, (), {}, {}), variables, since, at, here)


def test_drives_that_contradict_each_other_count_as_in_one_fit_of_all():
    rng = np.random.default_rng(1)
    fit = vehicle(rng, rng.normal(0.5, 0.1, (9, K)))
    found = result_of(fit, {file: file for file in fit.files}, (), 0.95, 0)
    each = np.array([s.at - s.gradient * NOISE**2 for s in fit.quadratic.shares])
    ratio, factors = heterogeneity_factors(each, np.full((9, K), NOISE**2), 0.95)
    # apart from the ranges, which are 12 against 10,000
    assert found.scatter == pytest.approx(ratio.max(), rel=0.01)
    # the jackknife does not take the noise of the drives, each 1, from what is as large alike
    factors = np.hypot(factors, np.sqrt(9.0) * student_factor(8, 0.95))
    width = np.array([high - low for low, high in VEHICLE.unknown.values()])
    std = np.sqrt(np.diag(found.covariance)) / width
    by_noise = np.sqrt(np.diag(fit.quadratic.covariance()))
    assert std / by_noise == pytest.approx(factors, rel=0.01)
    assert factors.min() > 5.0
    (line,) = (line for line in remarks_on_many(found) if "contradict each other" in line)
    assert f"up to {found.scatter:.1f} times" in line


@pytest.mark.parametrize("rows", [None, 3])
@pytest.mark.parametrize("drives", [2, 4, 9])
def test_intervals_of_drives_that_agree_hold_and_do_not_grow(drives, rows):
    rng, held, factors = np.random.default_rng(drives), [], []
    for _ in range(REPEATS):
        true = rng.normal(0.5, 0.05, K)
        fit = vehicle(rng, np.tile(true, (drives, 1)), rows=rows)
        factors.append(scatter_of(fit, 0.95).factors)
        std = np.sqrt(np.diag(fit.quadratic.covariance()))
        held.append(np.abs(fit.at - true) < 1.96 * factors[-1] * std)
    assert np.median(factors) == 1.0
    # in one fit of all, one set of drives in a hundred is taken for contradicting by chance
    assert np.sum(np.max(factors, axis=1) > 1.0) <= binom.ppf(0.999, REPEATS, 0.01)
    # errors of parameters of one fit are alike where drives tell only sums: count fits
    assert np.mean(held) > 0.95 - 3.0 * np.sqrt(0.95 * 0.05 / REPEATS / (K if rows is None else 1))


@pytest.mark.parametrize("rows", [None, 3])
@pytest.mark.parametrize("drives", [4, 9])
def test_intervals_hold_what_drives_err_by_alike_as_each_errs(drives, rows):
    """With three sums each, no drive alone shows a parameter: they only miss each other."""
    rng, held = np.random.default_rng(drives), []
    for _ in range(REPEATS):
        alike, own = rng.normal(0.0, 0.1, K), rng.normal(0.0, 0.1, (drives, K))
        fit = vehicle(rng, 0.5 + alike + own, rows=rows)
        scatter = scatter_of(fit, 0.95)
        std = np.sqrt(np.diag(fit.quadratic.covariance()))
        held.append(np.abs(fit.at - 0.5) < 1.96 * scatter.factors * std)
    assert np.mean(held) > 0.85


def test_drives_on_a_line_agree_where_the_parameter_changes():
    rng, since = np.random.default_rng(0), np.linspace(-1.0, 1.0, 5)
    values = np.full((5, K), 0.5)
    values[:, 0] -= 0.2 * since
    assert scatter_of(vehicle(rng, values, since=since), 0.95).factors.tolist() == [1.0] * (K + 1)
    constant = scatter_of(vehicle(rng, values), 0.95)
    assert constant.ratio[0] > CONTRADICTING
    values[:, 0] += rng.normal(0.0, 0.1, 5)
    apart = scatter_of(vehicle(rng, values, since=since), 0.95)
    assert apart.factors[[0, -1]].min() > 5.0


def test_one_drive_contradicts_nothing():
    found = scatter_of(vehicle(np.random.default_rng(0), np.full((1, K), 0.5)), 0.95)
    assert np.isnan(found.ratio).all()
    assert found.factors.tolist() == [1.0] * K


def test_a_vehicle_whose_drives_contradict_each_other_tells_its_fleet_little():
    rng, apart = np.random.default_rng(0), np.zeros((6, 3, K))
    apart[-1] = 0.1 * rng.normal(size=(3, K))
    fits = [vehicle(rng, 0.5 + own) for own in apart]
    evidence = FleetFit(fits, []).posterior(0.95).without_prior([0])
    std = np.sqrt(evidence.covariances[:, 0, 0])
    assert std[:-1] == pytest.approx(np.full(5, NOISE / 3**0.5), rel=0.01)
    assert std[-1] > 0.05
    found = evidence.population([*"abcdef"], 0, (0.0, 1.0), 0.95)
    assert not any(m.odd for m in found.members)


def test_few_vehicles_of_a_drive_each_that_contradict_each_other_know_little_of_what_they_share():
    rng = np.random.default_rng(0)
    for apart, wide in ((0.0, False), (0.1, True)):
        values = 0.5 + apart * rng.normal(size=(5, 1, K))
        found = FleetFit([vehicle(rng, own) for own in values], [0]).posterior(0.95)
        by_noise = NOISE / 5**0.5
        assert (found.shared_covariance[0, 0] ** 0.5 > 5.0 * by_noise) == wide
