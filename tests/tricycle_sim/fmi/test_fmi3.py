"""An FMU 3.0, and FMUs that fail: a bicycle in C, compiled by the test."""

import functools

import numpy as np
import pytest
from bicycle_fmu import ENDS, IS_NAN, REFUSES, needs_compiler, write_bicycle_fmu

from tricycle_core.errors import PlantError
from tricycle_sim.vehicle import load_vehicle

pytest.importorskip("fmpy")
pytestmark = [
    pytest.mark.slow,
    needs_compiler,
]
VEHICLE = load_vehicle()


@pytest.fixture
def bicycle(tmp_path):
    """Write the FMU and a mapping with start values; return the mapping's path."""
    return functools.partial(write_bicycle_fmu, tmp_path)


def test_it_drives_its_circle_in_its_units(bicycle):
    from tricycle_sim.plants.fmu_plant import fmu_plant

    plant = fmu_plant(VEHICLE, 0, bicycle())
    for tick in range(300):
        state = plant.hold_speed(tick, 0.1, 1.0, 0.0)
    assert state.vx == pytest.approx(1.0, abs=1e-9)
    assert state.yaw_rate == pytest.approx(np.tan(plant._servo.output / 0.5) / 2.0, rel=1e-6)
    plant.close()


def test_an_enumeration_is_set_by_its_number(bicycle):
    from tricycle_sim.plants.fmu_plant import fmu_plant

    plant = fmu_plant(VEHICLE, 0, bicycle(gear=2))
    assert plant.hold_speed(0, 0.0, 1.0, 0.0).vx == pytest.approx(-1.0)
    plant.close()


@pytest.mark.parametrize(
    ("fails", "line"),
    [(ENDS, r"ends at 0\.00 s"), (IS_NAN, r"x is nan at 0\.01 s"), (REFUSES, r"fails at 0\.00 s")],
)
def test_an_fmu_that_fails_is_one_line(bicycle, fails, line):
    from tricycle_sim.plants.fmu_plant import fmu_plant

    plant = fmu_plant(VEHICLE, 0, bicycle(fails=fails))
    with pytest.raises(PlantError, match=line) as problem:
        plant.hold_speed(0, 0.0, 1.0, 0.0)
    assert "\n" not in str(problem.value)
    plant.close()
