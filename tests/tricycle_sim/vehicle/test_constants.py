"""Constants of a vehicle are in their bounds; unknown ones have ranges."""

import json
import math
import subprocess
import sys

import numpy as np
import pytest

from tricycle_core.errors import VehicleError
from tricycle_sim.vehicle import UNKNOWN_PARAMETERS, draw_truth, load_vehicle


def test_static_loads_by_moment_balance():
    assert load_vehicle().static_loads() == pytest.approx((120.72, 115.37, 237.73), abs=0.005)


def test_replacing_a_value_changes_the_fingerprint_and_keeps_the_ranges():
    vehicle = load_vehicle()
    other = vehicle.replace(cornering_stiffness=800.0)
    assert other.nominal["cornering_stiffness"] == 800.0
    assert other.unknown == vehicle.unknown
    assert other.fingerprint != vehicle.fingerprint
    assert vehicle.replace().fingerprint == vehicle.fingerprint


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"masss": 1.0}, "did you mean mass?"),
        ({"mass": -1.0}, "mass: -1 kg is not in"),
        ({"friction_coefficient": -1.0}, "friction_coefficient: -1 is not in"),
        ({"mass": math.nan}, "mass: nan"),
        ({"cornering_stiffness": 2000.0}, "outside [500, 1500]"),
        ({"wheel_inertia": 1.0}, "wheel_inertia: no wheel reads it, but front_wheel_inertia and"),
        (
            {f"{wheel}.cornering_stiffness": 800.0 for wheel in ("left", "right", "rear")},
            "cornering_stiffness: no wheel reads it",  # its range would be that of nothing
        ),
    ],
)
def test_replace_refuses_what_cannot_be(values, message):
    with pytest.raises(VehicleError, match=r"^[^\n]*$") as error:
        load_vehicle().replace(**values)
    assert message in str(error.value)


def test_the_fingerprint_of_the_packaged_vehicle_is_that_of_old_plans():
    assert load_vehicle().fingerprint == "e0666e91b5ebab8a"


def test_every_unknown_parameter_is_a_constant_with_a_unit():
    assert all(load_vehicle().unit(name) for name in UNKNOWN_PARAMETERS)


def test_importing_and_loading_a_vehicle_compiles_nothing():
    script = (
        "import json, sys; from tricycle_sim.vehicle import load_vehicle; load_vehicle();"
        "print(json.dumps([m for m in ('numba', 'scipy', 'llvmlite') if m in sys.modules]))"
    )
    run = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True)
    assert json.loads(run.stdout) == []


def test_truth_is_drawn_from_the_ranges_and_the_seed():
    vehicle = load_vehicle()
    draws = [draw_truth(vehicle, np.random.default_rng(seed)) for seed in range(200)]
    assert draws[5] == draw_truth(vehicle, np.random.default_rng(5))
    for name, (low, high) in vehicle.unknown.items():
        values = np.array([draw[name] for draw in draws])
        assert low <= values.min() < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < values.max() <= high
