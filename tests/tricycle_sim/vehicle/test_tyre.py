"""The tyre: load, relaxation, rolling resistance, and the law of its force."""

import dataclasses
import math

import lagrange_oracle
import numpy as np
import pytest
import structures

from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.layout import LANES
from tricycle_sim.vehicle.tyre import (
    LAWS,
    LINEAR,
    MAGIC_FORMULA,
    SOFTENED,
    fiala,
    linear,
    magic_formula,
    rolling_resistance,
    slip_slopes,
    softened,
    unlimited,
    vertical_load,
)
from tricycle_sim.vehicle.tyre import TYRE as TYRE_ROWS

VEHICLE = load_vehicle()


def constants_of(formulas, vehicle=VEHICLE):
    """Constants of one vehicle, as they stand in a group."""
    return np.repeat([formula(vehicle.of("rear")) for formula in formulas.values()], LANES)


TYRE = constants_of(TYRE_ROWS)


def force(load=200.0, kappa=0.0, alpha=0.0, lean=0.0, vx=5.0, slip_speed=0.0, vy=0.0, **values):
    constants = constants_of(LINEAR, VEHICLE.replace(**values))
    return linear(constants, 0, load, kappa, alpha, lean, vx, slip_speed, vy)


def test_load_is_spring_and_damper_and_never_pulls():
    radius = VEHICLE.tyre_radius
    assert vertical_load(TYRE, 0, radius - 0.003, 1.0, 0.0) == pytest.approx(180.0)
    assert vertical_load(TYRE, 0, radius - 0.003, 1.0, 0.1) == pytest.approx(150.0)
    assert vertical_load(TYRE, 0, radius + 0.001, 1.0, 0.0) == 0.0


def test_slips_relax_over_their_lengths():
    kappa_slope, alpha_slope = slip_slopes(TYRE, 0, 5.0, 0.5, -0.2, 0.0, 0.0, 1.0)
    assert kappa_slope == pytest.approx(-0.5 / VEHICLE.longitudinal_relaxation_length)
    assert alpha_slope == pytest.approx(0.2 / VEHICLE.lateral_relaxation_length)
    # in the steady state the relaxed slips are those of the speeds
    speed = math.hypot(5.0, 0.1)
    steady = slip_slopes(TYRE, 0, 5.0, 0.5, -0.2, -0.5 / speed, 0.2 / speed, 1.0)
    assert steady == pytest.approx((0.0, 0.0), abs=1e-12)


def test_rolling_resistance_is_against_the_spin():
    moment = rolling_resistance(TYRE, 0, 0.33, 200.0, 2.0)
    assert moment == pytest.approx(0.33 * 200.0 * (0.009 + 5e-4 * 4.0), rel=1e-3)
    assert rolling_resistance(TYRE, 0, 0.33, 200.0, -2.0) == -moment
    assert rolling_resistance(TYRE, 0, 0.33, 200.0, 0.0) == 0.0


def test_small_slips_have_linear_forces():
    force_x, force_y, aligning, friction_squared, _ = force(kappa=0.001, alpha=0.002, lean=0.01)
    assert force_x == pytest.approx(3000.0 * 0.001, rel=1e-3)
    assert force_y == pytest.approx(1000.0 * 0.002 + 50.0 * 0.01, rel=1e-3)
    assert aligning == pytest.approx(-0.15 * 0.002, rel=1e-3)
    assert friction_squared == pytest.approx((3.0**2 + 2.5**2) / 160.0**2, rel=1e-3)


def test_forces_stay_within_the_friction_circle():
    force_x, force_y, _, friction_squared, _ = force(kappa=1.0, alpha=-1.0)
    assert math.hypot(force_x, force_y) == pytest.approx(0.8 * 200.0, rel=1e-3)
    assert force_y / force_x == pytest.approx(-1000.0 / 3000.0)
    assert friction_squared == pytest.approx(1.0, rel=1e-3)
    assert force(load=0.0, kappa=1.0, alpha=1.0)[:2] == pytest.approx((0.0, 0.0), abs=1e-3)


@pytest.mark.parametrize("slip", [0.02, 0.08, 1.0])
@pytest.mark.parametrize("law", [linear, fiala])
def test_the_share_of_the_friction_limit_is_that_of_the_limited_force(law, slip):
    force_x, force_y, _, friction_squared, _ = law(
        constants_of(LINEAR), 0, 200.0, slip, -slip, 0.0, 5.0, 0.0, 0.0
    )
    assert friction_squared == pytest.approx((force_x**2 + force_y**2) / 160.0**2, rel=1e-9)
    assert friction_squared <= 1.0


def test_stiffness_follows_the_load_where_the_vehicle_says_so():
    reference = VEHICLE.mass * VEHICLE.gravity / 3.0
    _, per_wheel, *_ = force(load=2.0 * reference, alpha=1e-3)
    _, per_load, *_ = force(load=2.0 * reference, alpha=1e-3, load_sensitivity=1.0)
    assert per_load == pytest.approx(2.0 * per_wheel, rel=1e-3)


def test_carcass_damping_fades_out_with_speed():
    slow, fast = (force(vx=speed, slip_speed=0.01, vy=0.01) for speed in (0.0, 50.0))
    assert slow[:2] == pytest.approx((-0.5, -0.6), rel=1e-3)
    assert fast[:2] == pytest.approx((0.0, 0.0), abs=1e-3)


@pytest.mark.parametrize("slip", [0.0, 0.003, 0.05, 0.3, 2.0])
@pytest.mark.parametrize("load", [0.0, 200.0])
def test_a_softened_tyre_is_a_mixture_of_a_linear_and_a_brush_tyre(slip, load):
    state = (load, 0.3 * slip, slip, 0.01, 5.0, 0.0, 0.0)
    soft = dataclasses.replace(VEHICLE, parts={"tyre": "softened"})
    constants = {
        saturation: constants_of(SOFTENED, soft.replace(tyre_saturation=saturation))
        for saturation in (0.0, 0.5, 1.0, 2.0)
    }
    own = constants_of(LINEAR)
    found = {s: softened(rows, 0, *state) for s, rows in constants.items()}
    assert found[0.0] == pytest.approx(linear(own, 0, *state), abs=1e-12)
    assert found[1.0] == pytest.approx(fiala(own, 0, *state), rel=1e-9, abs=1e-12)
    slippery = constants_of(LINEAR, VEHICLE.replace(friction_coefficient=0.4))
    assert found[2.0] == pytest.approx(fiala(slippery, 0, *state), rel=1e-9, abs=1e-12)
    middle = 0.5 * (np.array(found[0.0]) + found[1.0])
    np.testing.assert_allclose(found[0.5], middle, rtol=1e-12, atol=1e-12)


def test_a_softened_tyre_that_slips_by_speed_is_a_viscous_contact():
    soft = dataclasses.replace(VEHICLE, parts={"tyre": "softened"})
    viscous = constants_of(SOFTENED, soft.replace(slip_by_speed=1.0))
    damping = VEHICLE.values["cornering_stiffness"]  # N per m/s
    for speed in (0.0, 0.5, 1.0, 4.0):
        sideways, forward = 0.002, 0.001  # m/s, of the contact over the road
        x, y, _, _, stiffer = softened(viscous, 0, 1e5, forward, sideways, 0.0, speed, 0.0, 0.0)
        steady = slip_slopes(TYRE, 0, speed, -forward, -sideways, forward, sideways, stiffer)
        assert steady == pytest.approx((0.0, 0.0), abs=1e-12)
        assert y == pytest.approx(damping * sideways, rel=1e-6)
        assert x == pytest.approx(damping * forward, rel=1e-6)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("load", [0.0, 120.0, 500.0])
def test_every_law_is_that_of_the_oracle(law, load):
    """Which is written once more, from the formulas, and tested in `test_oracle.py`."""
    own = structures.MAGIC if law == "magic_formula" else {}
    if law == "softened":
        own = {"tyre_saturation": 0.6, "tyre_rounding": 0.7}
    vehicle = dataclasses.replace(
        VEHICLE, parts={"tyre": law}, values={**VEHICLE.values, **own, "load_sensitivity": 0.4}
    )
    rows, values = constants_of(LAWS[law].rows, vehicle), vehicle.of("rear")
    for kappa, alpha in np.random.default_rng(1).normal(0.0, 0.2, (20, 2)):
        state = (load, kappa, alpha, 0.02, 5.0, 0.0, 0.0)
        x0, y0 = unlimited(rows, 0, *state)
        x, y, share = lagrange_oracle.TYRE_LAWS[law](values, load, x0, y0)
        found = LAWS[law].function(rows, 0, *state)
        assert found[:2] == pytest.approx((x, y), rel=1e-9, abs=1e-6)
        moment = -values.self_aligning_stiffness * alpha * share
        assert found[2] == pytest.approx(moment, rel=1e-9, abs=1e-8)


def test_between_no_rounding_and_a_full_one_is_a_tyre_of_the_magic_formula():
    shapes = {
        "shape_longitudinal": 1.5,
        "curvature_longitudinal": -0.8,
        "shape_lateral": 1.5,
        "curvature_lateral": -0.8,
    }
    magic = dataclasses.replace(
        VEHICLE, parts={"tyre": "magic_formula"}, values={**VEHICLE.values, **shapes}
    )
    soft = dataclasses.replace(VEHICLE, parts={"tyre": "softened"})
    formula = constants_of(MAGIC_FORMULA, magic)
    ends = [constants_of(SOFTENED, soft.replace(tyre_rounding=rounding)) for rounding in (0.0, 1.0)]
    for slip in np.linspace(0.02, 1.0, 20) * 160.0 / VEHICLE.values["cornering_stiffness"]:
        state = (200.0, 0.0, slip, 0.0, 5.0, 0.0, 0.0)
        bent, straight = (softened(rows, 0, *state)[1] for rows in reversed(ends))
        assert bent < magic_formula(formula, 0, *state)[1] < straight
