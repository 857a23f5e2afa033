"""What the page about FMI shows."""

import re
from pathlib import Path

import pytest
import yaml

from tricycle_sim.vehicle import load_vehicle

pytest.importorskip("fmpy")
pytestmark = pytest.mark.slow
PAGE = (Path(__file__).parents[3] / "docs" / "how-to-fmi.md").read_text()
MAPPING = re.search(r"```yaml\n(.*?)```", PAGE, re.DOTALL)[1]
CODE = re.search(r"```python\n(.*?)```", PAGE, re.DOTALL)[1]
VEHICLE = Path(__file__).parents[3] / "src/tricycle_sim/tricycle_sim/tricycle.yaml"


def test_its_mapping_is_one_and_its_plan_is_found(exported, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    mapping = yaml.safe_load(MAPPING)
    mapping["fmu"] = str(exported)
    unknown = load_vehicle().unknown
    assert {"cornering_stiffness", "yaw_inertia"} < unknown.keys()
    mapping["parameters"] |= {n: n for n in unknown if n not in mapping["parameters"]}
    Path("car.yaml").write_text(yaml.safe_dump(mapping))
    Path("car_file.yaml").write_text(VEHICLE.read_text())
    scope = {}
    code = CODE.replace("budget=200", "budget=120")
    exec(compile(code.replace("samples=20", "samples=10, workers=1"), "page", "exec"), scope)
    low, high = zip(*scope["operation"].values(), strict=True)
    assert all(a <= x <= b for a, x, b in zip(low, scope["design"].x, high, strict=True))
