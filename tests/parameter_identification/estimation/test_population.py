"""Populations against draws from known ones, and against closed forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binom

from parameter_identification.estimation.population import population
from tricycle_core.errors import IdentificationError


def drawn(rng, count=12, mean=600.0, spread=30.0):
    deviations = rng.uniform(5.0, 40.0, count)
    true = mean + spread * rng.standard_normal(count)
    return true, true + deviations * rng.standard_normal(count), deviations


def names(count):
    return [f"trike {i}" for i in range(count)]


@pytest.mark.slow
@pytest.mark.parametrize(("count", "spread"), [(6, 30.0), (20, 30.0), (20, 5.0)])
def test_intervals_hold_what_the_vehicles_were_drawn_from(count, spread):
    rng, fleets, held = np.random.default_rng(0), 60, np.zeros(3)
    for _ in range(fleets):
        true, estimates, deviations = drawn(rng, count, spread=spread)
        found = population(names(count), estimates, deviations)
        held[0] += found.mean.low <= 600.0 <= found.mean.high
        held[1] += found.spread.low <= spread <= found.spread.high
        values = zip(true, found.members, strict=True)
        held[2] += np.mean([m.value.low <= t <= m.value.high for t, m in values])
    least = binom.ppf(0.001, fleets, 0.95) / fleets
    assert np.all(held / fleets > least), held / fleets


@pytest.mark.slow
def test_one_fleet_in_a_hundred_has_an_odd_vehicle_by_chance():
    rng, fleets = np.random.default_rng(1), 150
    odd = 0
    for _ in range(fleets):
        _, estimates, deviations = drawn(rng, 15)
        odd += any(m.odd for m in population(names(15), estimates, deviations).members)
    assert odd <= binom.ppf(0.999, fleets, 0.01)


def test_a_worn_tyre_is_odd_and_says_which_way():
    _, estimates, deviations = drawn(np.random.default_rng(2), 12, spread=10.0)
    estimates[4] -= 250.0
    found = population(names(12), estimates, deviations)
    rest = np.arange(12) != 4
    without = population(names(11), estimates[rest], deviations[rest])
    assert found.mean.middle == pytest.approx(without.mean.middle, abs=0.5)
    assert found.spread.high == pytest.approx(without.spread.high, rel=0.05)
    assert found.members[4].value.middle == pytest.approx(estimates[4])
    assert [m.vehicle for m in found.members if m.odd] == ["trike 4"]
    assert found.members[4].distance < -4.0


def test_without_errors_it_is_the_t_interval_of_the_mean():
    from scipy.stats import t

    values = np.array([580.0, 610.0, 595.0, 640.0, 570.0, 601.0, 622.0, 588.0])
    found = population(names(8), values, np.full(8, 1e-3))
    # a uniform prior of the spread leaves one degree of freedom less than the usual interval
    half = t.ppf(0.975, 6) * np.sqrt(np.sum((values - values.mean()) ** 2) / 6 / 8)
    assert found.mean.middle == pytest.approx(values.mean(), abs=0.05)
    assert found.mean.high - found.mean.low == pytest.approx(2.0 * half, rel=0.02)
    for value, member in zip(values, found.members, strict=True):
        assert member.value.middle == pytest.approx(value, abs=0.1)


@settings(max_examples=20)
@given(shift=st.floats(-1e3, 1e3), factor=st.floats(0.01, 100.0))
def test_units_do_not_matter(shift, factor):
    _, estimates, deviations = drawn(np.random.default_rng(3), 6)
    here = population(names(6), estimates, deviations)
    there = population(names(6), factor * estimates + shift, factor * deviations)
    scale = factor * 30.0
    assert there.mean.low == pytest.approx(factor * here.mean.low + shift, abs=1e-5 * scale)
    assert there.spread.high == pytest.approx(factor * here.spread.high, rel=1e-5)
    assert [m.distance for m in there.members] == pytest.approx(
        [m.distance for m in here.members], abs=1e-5
    )


def test_an_error_that_all_have_in_common_widens_the_mean_and_moves_no_vehicle_from_the_others():
    _, estimates, deviations = drawn(np.random.default_rng(4), 12)
    plain = population(names(12), estimates, deviations)
    found = population(names(12), estimates, deviations, common_errors=np.full((12, 1), 50.0))
    half = [0.5 * (p.mean.high - p.mean.low) for p in (plain, found)]
    assert half[1] == pytest.approx(np.hypot(half[0], 1.96 * 50.0), rel=0.02)
    assert found.spread.middle == pytest.approx(plain.spread.middle, rel=1e-6)
    assert [m.distance for m in found.members] == pytest.approx(
        [m.distance for m in plain.members], abs=1e-6
    )


def test_errors_in_common_do_not_count_as_spread():
    rng = np.random.default_rng(5)
    common = rng.uniform(-60.0, 60.0, (40, 1))
    deviations = np.full(40, 5.0)
    estimates = 600.0 + 1.5 * common[:, 0] + 10.0 * rng.standard_normal(40)
    found = population(names(40), estimates, deviations, common_errors=common)
    assert found.spread.high < 15.0
    assert found.mean.low < 600.0 < found.mean.high


@pytest.mark.slow
def test_the_interval_of_an_odd_vehicle_counts_what_it_shares_with_others():
    rng, fleets, count = np.random.default_rng(1), 400, 12
    held = []
    for _ in range(fleets):
        true = rng.standard_normal(count)
        true[0] += 30.0
        common = rng.normal(1.0, 0.1, count)
        estimates = true + 0.3 * rng.standard_normal(count) + common * rng.standard_normal()
        found = population(
            names(count), estimates, np.full(count, 0.3), common_errors=common[:, None]
        )
        odd, value = found.members[0], found.members[0].value
        if odd.odd:
            assert odd.deviation == pytest.approx(np.hypot(0.3, common[0]))
            held.append(value.low <= true[0] <= value.high)
    assert len(held) > 0.9 * fleets
    assert np.mean(held) > 0.9


def test_two_odd_vehicles_do_not_hide_each_other():
    _, estimates, deviations = drawn(np.random.default_rng(6), 10, spread=10.0)
    estimates[[2, 7]] += 600.0
    members = population(names(10), estimates, deviations).members
    assert [m.vehicle for m in members if m.odd] == ["trike 2", "trike 7"]


def test_odd_is_called_one_of_at_least_five():
    for count, odd in ((4, False), (5, True)):
        estimates = np.append(np.linspace(-1.0, 1.0, count - 1), 1e6)
        found = population(names(count), estimates, np.full(count, 0.1))
        assert [m.odd for m in found.members] == [False] * (count - 1) + [odd]


def test_three_vehicles_are_no_population():
    with pytest.raises(IdentificationError, match="3 vehicles are no population: 4"):
        population(names(3), np.ones(3), np.ones(3))
    with pytest.raises(IdentificationError, match="positive"):
        population(names(4), np.ones(4), np.zeros(4))
