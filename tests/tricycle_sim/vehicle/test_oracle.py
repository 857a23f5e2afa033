"""The oracle itself, before anything is compared with it: energy, laws, static loads."""

import math
from types import SimpleNamespace

import lagrange_oracle
import numpy as np
import pytest
import structures

from tricycle_sim.vehicle import load_vehicle

STRUCTURES = structures.STRUCTURES
VEHICLE = load_vehicle()
SHARED = dict(VEHICLE.values)


def described(structure, **constants):
    values = SHARED | structure["constants"] | constants
    return lagrange_oracle.describe_file(structure["wheels"], structure["parts"], values)


def somewhere(vehicle, rng):
    """A state of everything, as in the middle of a rough drive."""
    n = len(vehicle.wheels)
    height = 0.49 + rng.uniform(-0.02, 0.0)
    return SimpleNamespace(
        q=np.array([1.0, 2.0, height, *rng.uniform(-0.1, 0.1, 3), *np.zeros(n)]),
        dq=np.array([2.0, 0.3, 0.1, *rng.uniform(-1.0, 1.0, 3), *rng.uniform(2.0, 9.0, n)]),
        kappa=rng.uniform(-0.2, 0.2, n),
        alpha=rng.uniform(-0.2, 0.2, n),
        torque=12.0,
        integrator=0.3,
    )


@pytest.mark.slow  # derives the equations
@pytest.mark.parametrize("name", STRUCTURES)
def test_kinetic_energy_grows_by_the_power_of_the_forces(name):
    vehicle = described(STRUCTURES[name])
    n = len(vehicle.wheels)
    state = somewhere(vehicle, np.random.default_rng(1))
    angles, _ = vehicle.steering(0.2)
    still = (angles, np.zeros(n))
    result = lagrange_oracle.derivative(vehicle, state, still, (1.0, 0.0, 0.3))

    def energy(seconds):
        q = state.q + seconds * state.dq + 0.5 * seconds**2 * result.ddq
        return lagrange_oracle.kinetic_energy(vehicle, q, state.dq + seconds * result.ddq, still)

    assert (energy(1e-5) - energy(-1e-5)) / 2e-5 == pytest.approx(result.external, rel=1e-6)


def tyre(law, **constants):
    values = SHARED | STRUCTURES["all_wheels"]["constants"] | constants
    return SimpleNamespace(**values, law=lagrange_oracle.TYRE_LAWS[law], mean_load=200.0)


@pytest.mark.parametrize("law", lagrange_oracle.TYRE_LAWS)
def test_every_law_has_the_linear_slope_and_the_friction_limit(law):
    t = tyre(
        law,
        friction_coefficient=0.8,
        shape_longitudinal=1.0,
        shape_lateral=1.0,
        tyre_saturation=0.7,
        tyre_rounding=0.4,
    )
    x, y, aligning = t.law(t, 200.0, 3e-3, -4e-3)
    assert (x, y, aligning) == pytest.approx((3e-3, -4e-3, 1.0), rel=1e-4)
    x, y, _ = t.law(t, 200.0, -3e6, 4e6)
    assert (x, y) == pytest.approx((-0.6 * 160.0, 0.8 * 160.0), rel=1e-4)
    assert t.law(t, 0.0, 1.0, 1.0)[:2] == pytest.approx((0.0, 0.0), abs=1e-9)


def test_the_brush_slides_from_three_times_its_limit():
    t = tyre("fiala")
    slides = 3.0 * 0.8 * 200.0
    assert t.law(t, 200.0, 0.0, 1.001 * slides) == pytest.approx((0.0, 160.0, 0.0))
    assert t.law(t, 200.0, 0.0, 0.5 * slides) == pytest.approx((0.0, 140.0, 0.125))


def test_the_magic_formula_peaks_and_falls_and_its_friction_with_the_load():
    t = tyre("magic_formula")
    forces = np.array([t.law(t, 200.0, 0.0, y)[1] for y in np.linspace(0.0, 4000.0, 400)])
    assert forces.max() == pytest.approx(160.0, rel=1e-3)
    assert forces[-1] == pytest.approx(160.0 * math.sin(1.3 * math.pi / 2), rel=0.05)
    peak = max(t.law(t, 400.0, 0.0, y)[1] for y in np.linspace(0.0, 4000.0, 400))
    assert peak == pytest.approx(0.9 * 320.0, rel=1e-3)  # a tenth less at twice the mean load


@pytest.mark.parametrize("name", ["car", "rear_steered"])
@pytest.mark.parametrize("angle", [-0.5, -0.05, 0.05, 0.5])
def test_with_ackermann_all_wheels_roll_about_one_centre(name, angle):
    structure = STRUCTURES[name]
    vehicle = described(structure, steering_offset=0.0)
    angles, slopes = vehicle.steering(angle)
    x, y = np.array([wheel.position[:2] for wheel in vehicle.wheels]).T
    unsteered = angles == 0.0
    steered = ~unsteered
    base = abs(x[steered][0] - x[unsteered][0])
    # from the turn's centre: beside the unsteered axle, at the radius of the bicycle
    center = (x[unsteered][0], y[steered].mean() + base / math.tan(angle))
    along = np.cos(angles), np.sin(angles)
    assert along[0] * (x - center[0]) + along[1] * (y - center[1]) == pytest.approx(0.0, abs=1e-12)
    between = (vehicle.steering(angle + 1e-6)[0] - vehicle.steering(angle - 1e-6)[0]) / 2e-6
    assert slopes == pytest.approx(between, abs=1e-8)


def test_the_steering_is_smooth_through_the_centre():
    vehicle = described(STRUCTURES["car"])
    for angle in (0.0, 1e-12, 1e-8):
        angles, slopes = vehicle.steering(angle)
        assert angles == pytest.approx([angle, angle, 0.0, 0.0], rel=1e-6)
        assert slopes == pytest.approx([1.0, 1.0, 0.0, 0.0], rel=1e-6)


@pytest.mark.parametrize("name", STRUCTURES)
def test_the_drive_gives_its_whole_torque(name):
    wheels = described(STRUCTURES[name]).wheels
    assert sum(wheel.torque_share for wheel in wheels) == pytest.approx(1.0)
    assert sum(wheel.brake_torque for wheel in wheels) == pytest.approx(VEHICLE.brake_torque)
