"""A bicycle in C as an FMU 3.0, compiled by the tests; it fails as it is told to."""

import platform
import shutil
import subprocess
import zipfile
from pathlib import Path

import pytest
import yaml

needs_compiler = pytest.mark.skipif(
    shutil.which("gcc") is None or platform.machine() != "x86_64", reason="needs gcc on x86-64"
)

VARIABLES = [
    ("steering", "input", "deg"), ("speed", "input", "m/s"), ("x", "output", "m"),
    ("y", "output", "m"), ("heading", "output", "rad"), ("wheelbase", "parameter", "m"),
    ("fails", "parameter", "1"), ("fails_from", "parameter", "m"),
]  # fmt: skip
VARIABILITY = {"input": "continuous", "output": "continuous", "parameter": "fixed"}
START = {"input": 'start="0"', "output": "", "parameter": 'start="0"'}
ENDS, IS_NAN, REFUSES = 1.0, 2.0, 3.0  # values of `fails`, from the distance `fails_from` on


def write_bicycle_fmu(folder, *, mapping=None, **start_values):
    """Write the FMU and its mapping, with changed parts and start values; return the mapping."""
    source = Path(__file__).with_name("kinematic.c")
    binary = folder / "bicycle.so"
    subprocess.run(
        ["gcc", "-w", "-O1", "-shared", "-fPIC", "-o", binary, source, "-lm"], check=True
    )
    listed = "".join(
        f'<Float64 name="{name}" valueReference="{number}" causality="{causality}" '
        f'variability="{VARIABILITY[causality]}" unit="{unit}" {START[causality]}/>'
        for number, (name, causality, unit) in enumerate(VARIABLES)
    )
    with zipfile.ZipFile(folder / "bicycle.fmu", "w") as archive:
        archive.writestr(
            "modelDescription.xml",
            '<fmiModelDescription fmiVersion="3.0" modelName="bicycle" '
            'instantiationToken="a"><CoSimulation modelIdentifier="bicycle"/>'
            '<TypeDefinitions><EnumerationType name="Gear"><Item name="forward" value="1"/>'
            '<Item name="reverse" value="2"/></EnumerationType></TypeDefinitions>'
            f"<ModelVariables>{listed}"
            f'<Enumeration name="gear" declaredType="Gear" valueReference="{len(VARIABLES)}" '
            'causality="parameter" variability="fixed" start="1"/></ModelVariables>'
            "<ModelStructure/></fmiModelDescription>",
        )
        archive.write(binary, "binaries/x86_64-linux/bicycle.so")
    path = folder / "bicycle.yaml"
    content = {
        "fmu": "bicycle.fmu",
        "inputs": {"steering": {"variable": "steering", "scale": 0.5}, "speed": "speed"},
        "outputs": {"x": "x", "y": "y", "heading": "heading"},
        "start_values": {"wheelbase": 2.0, **start_values},
        **(mapping or {}),
    }
    path.write_text(yaml.safe_dump(content))
    return path
