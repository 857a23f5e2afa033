"""Files of plans: they survive, and damaged ones are refused with file and field."""

import dataclasses
import json

import numpy as np
import pytest

from excitation_planner import MeasurementNoise
from excitation_planner.maneuver import Circle
from excitation_planner.plan import SearchHistory, load_plan, save_plan
from excitation_planner.planning import PlanRequest, plan_at
from tricycle_core.errors import PlanError
from tricycle_core.stopping import Cause, stopping_distance
from tricycle_sim.vehicle import load_vehicle


@pytest.fixture(scope="module")
def plan():
    noise = MeasurementNoise(yaw_rate_std=0.004, drift_time=7.0)
    circle = Circle(duration=2.0)
    request = PlanRequest(load_vehicle(), circle, "cornering_stiffness", samples=20, noise=noise)
    return plan_at(request, np.array([3.0, 0.8]))


def test_a_saved_plan_is_the_same_plan(plan, tmp_path):
    file = tmp_path / "deep" / "plan.json"
    save_plan(plan, file)
    loaded = load_plan(file)
    assert loaded.id == plan.id
    assert (loaded.operation, loaded.main, loaded.unknown) == (
        dict(plan.operation),
        dict(plan.main),
        dict(plan.unknown),
    )
    assert np.array_equal(loaded.reference.yaw, plan.reference.yaw)
    assert loaded.noise == plan.noise
    assert [entry.name for entry in file.parent.iterdir()] == ["plan.json"]  # nothing half-written


def test_what_is_loaded_is_saved_as_it_was(plan, tmp_path):
    first, second = tmp_path / "first.json", tmp_path / "second.json"
    save_plan(plan, first)
    save_plan(load_plan(first), second)
    assert first.read_bytes() == second.read_bytes()


def test_a_plan_that_was_only_laid_out_anew_is_the_same(plan, tmp_path):
    file = tmp_path / "plan.json"
    save_plan(plan, file)
    document = json.loads(file.read_text(), parse_float=_whole_where_it_is)
    file.write_text(json.dumps(document, indent=2, sort_keys=True))
    assert load_plan(file).checksum == plan.checksum


def _whole_where_it_is(text):
    number = float(text)
    return int(number) if number.is_integer() else number  # as jq and JavaScript write it


def test_whole_numbers_are_read_back(plan, tmp_path):
    noise = dataclasses.replace(plan.noise, pose_rate=100)
    operation = dict.fromkeys(plan.operation, 3)
    save_plan(dataclasses.replace(plan, noise=noise, operation=operation), tmp_path / "plan.json")
    assert load_plan(tmp_path / "plan.json").noise == noise


def test_the_noise_stands_beside_the_other_fields(plan, tmp_path):
    save_plan(plan, tmp_path / "plan.json")
    document = json.loads((tmp_path / "plan.json").read_text())
    assert (document["noise_std"], document["yaw_rate_std"], document["drift_time"]) == (
        0.01,
        0.004,
        7.0,
    )
    assert "noise" not in document


def test_the_search_is_kept_with_what_cannot_be_driven(plan, tmp_path):
    search = SearchHistory(np.array([[3.0, 0.8], [2.0, 1.0]]), np.array([1.5, np.inf]))
    save_plan(dataclasses.replace(plan, search=search), tmp_path / "plan.json")
    loaded = load_plan(tmp_path / "plan.json").search
    assert np.array_equal(loaded.x, search.x)
    assert np.array_equal(loaded.cost, search.cost)


def _without(document, *path):
    inner = document
    for key in path[:-1]:
        inner = inner[key]
    del inner[path[-1]]


def _with(document, value, *path):
    inner = document
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: _without(d, "target"), "lacks `target`"),
        (lambda d: _without(d, "drift_std"), r"noise\.drift_std: needs a number, not nothing"),
        (lambda d: _with(d, -1.0, "drift_std"), "drift_std = -1 m must be from 0 to 10"),
        (lambda d: _with(d, "mass", "target"), "target 'mass' is not an unknown parameter"),
        (lambda d: _without(d, "main", "yaw_inertia"), "main must have an index of each unknown"),
        (lambda d: _with(d, 99, "schema"), "schema 99; this version reads 3"),
        (lambda d: _with(d, "b", "criterion"), "criterion: Invalid enum value 'b'"),
        (
            lambda d: _with(d, None, "predicted_std", "yaw_inertia"),
            r"predicted_std.*: needs a number",
        ),
        (lambda d: _with(d, "x", "cost"), "cost: needs a number, not a text"),
        (lambda d: _with(d, True, "seed"), "seed: needs a whole number, not true or false"),
        (lambda d: _with(d, [1, 2], "commands", "time"), r"commands: .*"),
        (
            lambda d: _with(d, ["a"], "commands", "speed"),
            r"commands\.speed: needs a list of numbers",
        ),
        (lambda d: _with(d, [[1, 2, 3]], "path"), "path must be a list of finite numbers"),
        (lambda d: _without(d, "reference", "yaw"), "reference: lacks `yaw`"),
        (
            lambda d: _with(d, {key: [] for key in ("time", "x", "y", "yaw")}, "reference"),
            "reference: time must be a list of finite numbers",
        ),
        (lambda d: _with(d, 0.5, "commands", "speed", 7), "changed after planning"),
        (lambda d: _with(d, 3.5, "operation", "radius"), "changed after planning"),
        (lambda d: _with(d, [0.1, 1e9], "ranges", "radius"), "changed after planning"),
        (lambda d: _without(d, "checksum"), "changed after planning"),
        (lambda d: _with(d, {}, "main", "cornering_stiffness"), r"main.*: lacks `value`"),
        (lambda d: _with(d, {"x": [[1, 2]], "cost": []}, "search"), "search: cost must be a list"),
    ],
)
def test_a_damaged_plan_is_refused_with_file_and_field(plan, tmp_path, change, message):
    file = tmp_path / "plan.json"
    save_plan(plan, file)
    document = json.loads(file.read_text())
    change(document)
    file.write_text(json.dumps(document))
    with pytest.raises(PlanError, match=message) as error:
        load_plan(file)
    assert str(file) in str(error.value)


@pytest.mark.parametrize("text", ["", "{", "[1]", "null", '{"schema": 2, "cost": NaN}', "[" * 9999])
def test_what_is_no_plan_is_refused(tmp_path, text):
    file = tmp_path / "plan.json"
    file.write_text(text)
    with pytest.raises(PlanError, match=str(file)):
        load_plan(file)


def test_a_plan_knows_the_room_that_it_needs(plan):
    along, across, stop = plan.space
    reference = plan.reference
    assert (along, across) == pytest.approx((np.ptp(reference.x), np.ptp(reference.y)))
    straight = dataclasses.replace(
        plan, path=np.column_stack([np.linspace(0.0, 99.0, len(plan.path)), 0 * plan.path[:, 0]])
    )  # paths lead on beyond their end
    assert straight.space == plan.space
    fastest = abs(plan.commands.speed).max()
    assert stop == max(stopping_distance(cause, fastest) for cause in Cause)
    assert stop > fastest**2 / 2
