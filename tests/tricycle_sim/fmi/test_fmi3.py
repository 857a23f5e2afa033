"""An FMU 3.0, and FMUs that fail: a bicycle in C, compiled by the test."""

import platform
import shutil
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest
import yaml

from tricycle_core.errors import PlantError
from tricycle_sim.vehicle import load_vehicle

pytest.importorskip("fmpy")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        shutil.which("gcc") is None or platform.machine() != "x86_64", reason="needs gcc on x86-64"
    ),
]
VEHICLE = load_vehicle()
VARIABLES = [
    ("steering", "input", "deg"), ("speed", "input", "m/s"), ("x", "output", "m"),
    ("y", "output", "m"), ("heading", "output", "rad"), ("wheelbase", "parameter", "m"),
    ("fails", "parameter", "1"),
]  # fmt: skip

VARIABILITY = {"input": "continuous", "output": "continuous", "parameter": "fixed"}
START = {"input": 'start="0"', "output": "", "parameter": 'start="0"'}


@pytest.fixture
def bicycle(tmp_path):
    """Write the FMU and a mapping with start values; return the mapping's path."""

    def write(**start_values):
        source = Path(__file__).with_name("kinematic.c")
        binary = tmp_path / "bicycle.so"
        command = ["gcc", "-w", "-O1", "-shared", "-fPIC", "-o", binary, source, "-lm"]
        subprocess.run(command, check=True)
        listed = "".join(
            f'<Float64 name="{name}" valueReference="{number}" causality="{causality}" '
            f'variability="{VARIABILITY[causality]}" unit="{unit}" {START[causality]}/>'
            for number, (name, causality, unit) in enumerate(VARIABLES)
        )
        with zipfile.ZipFile(tmp_path / "bicycle.fmu", "w") as archive:
            archive.writestr(
                "modelDescription.xml",
                '<fmiModelDescription fmiVersion="3.0" modelName="bicycle" '
                'instantiationToken="a"><CoSimulation modelIdentifier="bicycle"/>'
                f"<ModelVariables>{listed}</ModelVariables><ModelStructure/>"
                "</fmiModelDescription>",
            )
            archive.write(binary, "binaries/x86_64-linux/bicycle.so")
        path = tmp_path / "bicycle.yaml"
        mapping = {
            "fmu": "bicycle.fmu",
            "inputs": {"steering": {"variable": "steering", "scale": 0.5}, "speed": "speed"},
            "outputs": {"x": "x", "y": "y", "heading": "heading"},
            "start_values": {"wheelbase": 2.0, **start_values},
        }
        path.write_text(yaml.safe_dump(mapping))
        return path

    return write


def test_it_drives_its_circle_in_its_units(bicycle):
    from tricycle_sim.plants.fmu_plant import fmu_plant

    plant = fmu_plant(VEHICLE, 0, bicycle())
    for tick in range(300):
        state = plant.hold_speed(tick, 0.1, 1.0, 0.0)
    assert state.vx == pytest.approx(1.0, abs=1e-9)
    assert state.yaw_rate == pytest.approx(np.tan(plant._servo.output / 0.5) / 2.0, rel=1e-6)
    plant.close()


@pytest.mark.parametrize(
    ("fails", "line"),
    [(1.0, r"ends at 0\.00 s"), (2.0, r"x is nan at 0\.01 s"), (3.0, r"fails at 0\.00 s")],
)
def test_an_fmu_that_fails_is_one_line(bicycle, fails, line):
    from tricycle_sim.plants.fmu_plant import fmu_plant

    plant = fmu_plant(VEHICLE, 0, bicycle(fails=fails))
    with pytest.raises(PlantError, match=line) as problem:
        plant.hold_speed(0, 0.0, 1.0, 0.0)
    assert "\n" not in str(problem.value)
    plant.close()
