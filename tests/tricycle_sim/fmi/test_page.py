"""What the page about FMI shows."""

import re
from pathlib import Path

import pytest

pytest.importorskip("fmpy")
pytestmark = pytest.mark.slow
PAGE = (Path(__file__).parents[3] / "docs" / "how-to-fmi.md").read_text()
MAPPING = re.search(r"```yaml\n(.*?)```", PAGE, re.DOTALL)[1]
CODE = re.search(r"```python\n(.*?)```", PAGE, re.DOTALL)[1]
VEHICLE = Path(__file__).parents[3] / "src/tricycle_sim/tricycle_sim/tricycle.yaml"


def test_its_mapping_is_one_and_its_plan_is_found(exported, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("my_vehicle.fmu").write_bytes(exported.read_bytes())
    Path("mapping.yaml").write_text(MAPPING)
    Path("my_vehicle.yaml").write_text(VEHICLE.read_text())
    scope = {}
    exec(compile(CODE.replace("samples=20", "samples=20, workers=1"), "page", "exec"), scope)
    low, high = zip(*scope["operation"].values(), strict=True)
    assert all(a <= x <= b for a, x, b in zip(low, scope["design"].x, high, strict=True))
    x, verdict, explanation = capsys.readouterr().out.splitlines()
    shown = PAGE.split("the parameter:\n\n```\n")[1].splitlines()
    assert [float(v) for v in x.strip("[]").split()] == pytest.approx(
        [float(v) for v in shown[0].strip("[]").split()], rel=0.01
    )
    assert [verdict, explanation.partition(" 0.")[0]] == [shown[1], shown[2].partition(" 0.")[0]]
