"""What importing the planner costs: light modules stay light, and any order of imports works."""

import subprocess
import sys

import pytest

HEAVY = ("cobyqa", "matplotlib", "numba", "rclpy", "scipy", "sklearn")


def run(code):
    """Standard output of a fresh interpreter."""
    return subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True
    ).stdout.strip()


def heavy_after(code):
    return run(f"{code}\nimport sys\nprint(*[m for m in {HEAVY} if m in sys.modules])").split()


@pytest.mark.parametrize(
    "code",
    [
        "import excitation_planner",
        "from excitation_planner import Box, DesignError, Evaluation, MeasurementNoise, Search",
        "from excitation_planner.plan import load_plan, save_plan",
        "from excitation_planner.maneuver import Circle, family_by_name\nfamily_by_name('slalom')",
        "from excitation_planner.maneuver import family_by_name\nfamily_by_name('step_steer')",
        "from excitation_planner.planning import PlanRequest",
        "import excitation_planner.playback",
    ],
)
def test_plans_requests_and_families_need_neither_scipy_nor_numba(code):
    assert heavy_after(code) == []


def test_sensitivity_needs_neither_numba_nor_scikit_learn():
    assert heavy_after("from excitation_planner import Study, design_excitation, sensitivity") == [
        "cobyqa",
        "scipy",
    ]


@pytest.mark.parametrize(
    "first",
    [
        "",
        "import excitation_planner.indices.sensitivity",
        "import excitation_planner.design.study, excitation_planner.indices.sobol",
        "import excitation_planner.box, excitation_planner.design.excitation",
        "from excitation_planner import indices, design\n"
        "from excitation_planner.indices import sensitivity",
    ],
)
def test_in_any_order_the_names_are_the_functions(first):
    names = "Box, Study, design_excitation, sensitivity"
    code = f"{first}\nfrom excitation_planner import {names}\nprint(*map(callable, [{names}]))"
    assert run(code) == "True True True True"


@pytest.mark.parametrize(
    "first", ["", "import excitation_planner.plan", "import excitation_planner.planning.planner"]
)
def test_in_any_order_the_planners_names_are_its_functions(first):
    names = "PlanRequest, plan_at, plan_maneuver, plan_set, random_feasible_point"
    code = (
        f"{first}\nfrom excitation_planner.planning import {names}\n"
        f"print(all(map(callable, [{names}])))"
    )
    assert run(code) == "True"


@pytest.mark.parametrize("package", ["excitation_planner", "excitation_planner.planning"])
def test_every_name_that_is_offered_exists(package):
    code = f"import {package} as p\nprint([n for n in p.__all__ if not hasattr(p, n)])"
    assert run(code) == "[]"
