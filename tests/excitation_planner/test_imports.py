"""What importing the planner costs: light modules stay light, and any order of imports works."""

import subprocess
import sys

import pytest

HEAVY = ("cobyqa", "matplotlib", "numba", "rclpy", "scipy", "sklearn")


LIGHT = (
    "import excitation_planner",
    "from excitation_planner import Box, DesignError, Evaluation, MeasurementNoise, Search",
    "from excitation_planner.plan import load_plan, save_plan",
    "from excitation_planner.maneuver import Circle, family_by_name; family_by_name('slalom')",
    "from excitation_planner.maneuver import family_by_name; family_by_name('step_steer')",
    "from excitation_planner.planning import PlanRequest",
    "import excitation_planner.playback",
)


def run(code):
    """Standard output of a fresh interpreter."""
    return subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    ).stdout.splitlines()


@pytest.mark.slow
def test_plans_requests_and_families_need_neither_scipy_nor_numba():
    found = f"import sys; print([m for m in {HEAVY} if m in sys.modules])"
    heavy = run("\n".join(f"{line}\n{found}" for line in LIGHT))
    assert dict(zip(LIGHT, heavy, strict=True)) == dict.fromkeys(LIGHT, "[]")


def test_the_help_of_plan_waits_for_no_simulator_and_no_message_table():
    code = "import sys, tricycle_cli.main as main; main.parser(['plan']).format_help()\n"
    waits = (*HEAVY, "rich", "shapely", "tricycle_bridge.protocol.messages")
    assert run(f"{code}print(*[m for m in {waits} if m in sys.modules])") == [""]


@pytest.mark.slow
def test_sensitivity_needs_neither_numba_nor_scikit_learn():
    code = "from excitation_planner import Study, design_excitation, sensitivity\nimport sys\n"
    assert run(f"{code}print(*[m for m in {HEAVY} if m in sys.modules])") == ["cobyqa scipy"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "first",
    [
        "",
        "import excitation_planner.design.study, excitation_planner.indices.sobol\n"
        "import excitation_planner.box, excitation_planner.design.excitation\n"
        "import excitation_planner.planning.planner\n"
        "from excitation_planner import indices, design\n"
        "from excitation_planner.indices import sensitivity",
    ],
)
def test_whatever_is_imported_first_the_names_are_the_functions(first):
    code = f"""{first}
import excitation_planner, excitation_planner.planning
from excitation_planner import Box, Study, design_excitation, sensitivity
from excitation_planner.planning import PlanRequest, plan_at, plan_maneuver, plan_set
print(all(map(callable, [Box, Study, design_excitation, sensitivity, PlanRequest, plan_at])))
for package in (excitation_planner, excitation_planner.planning):
    print([name for name in package.__all__ if not hasattr(package, name)])"""
    assert run(code) == ["True", "[]", "[]"]
