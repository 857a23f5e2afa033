"""Studies on disk: ask and tell, resumption after a kill, and what must not damage them."""

import csv
import json
import subprocess
import sys
from dataclasses import fields
from inspect import signature

import numpy as np
import pytest

from excitation_planner import Design, Study, TrajectoryErrorNoise, design_excitation
from excitation_planner.box import Box
from excitation_planner.design.criteria import Criterion
from excitation_planner.design.noise import TrajectoryNoise
from excitation_planner.design.prior import BoxPrior, NuisanceParameters
from excitation_planner.design.problem import DesignProblem, Search
from excitation_planner.design.store import Store
from excitation_planner.design.study_document import StudyDocument
from tricycle_core.errors import DesignError, InfeasibleManeuver

OPERATION = {"a": (-1.0, 1.0), "b": (0.0, 2.0)}
UNKNOWN = {"p": (0.0, 1.0), "q": (10.0, 20.0)}
ARGUMENTS = {"samples": 12, "budget": 460, "seed": 5}


def f(x, P):
    if x[0] > 0.9:
        raise InfeasibleManeuver("too fast")
    q = (P[:, 1] - 10) / 10
    m = P[:, 0] + 0.3 * P[:, 0] * q + (0.1 + (x[0] - 0.2) ** 2 + (x[1] - 0.7) ** 2) * q
    m[3] = np.nan
    return m


def test_a_number_is_no_trajectory_and_none_a_number(tmp_path):
    study = Study.create(tmp_path, OPERATION, UNKNOWN, "p", **ARGUMENTS)
    p = study.ask()[0]
    with pytest.raises(
        DesignError, match=r"told \(1, 3, 2\) for 1 samples; criterion h needs a num"
    ):
        study.tell(p.point, [0], np.zeros((1, 3, 2)))
    with pytest.raises(DesignError, match=r"told \(2,\) for 1 samples"):
        study.tell(p.point, [0], np.zeros(2))


def test_a_study_has_the_settings_of_a_design_and_their_defaults():
    call, create = (signature(one).parameters for one in (design_excitation, Study.create))
    for name in (field.name for field in fields(DesignProblem)):
        assert create[name].default == call[name].default


def test_every_setting_of_a_problem_comes_back_from_its_description():
    problem = DesignProblem(
        operation=Box.of(OPERATION),
        unknown=Box.of(UNKNOWN),
        target="q",
        criterion=Criterion.C,
        noise_variance=2.0,
        trajectory_noise=TrajectoryNoise(),
        samples=13,
        draws=5,
        budget=5000,
        seed=7,
        search=Search.DIRECT,
        prior=BoxPrior.uniform(2),
        nuisances=NuisanceParameters(steps=(0.1,)),
    )
    found = StudyDocument.of(problem).problem()
    for name in (field.name for field in fields(DesignProblem)):
        assert repr(getattr(found, name)) == repr(getattr(problem, name))


def by_call(**arguments) -> Design:
    return design_excitation(f, OPERATION, UNKNOWN, "p", workers=1, **ARGUMENTS | arguments)


def assert_same(one: Design, other: Design) -> None:
    assert np.array_equal(one.x, other.x)
    assert one.cost == other.cost
    assert one.cost_interval == other.cost_interval
    assert [e.cost for e in one.history] == [e.cost for e in other.history]
    assert (one.simulations, one.failed) == (other.simulations, other.failed)


def answer(study: Study, proposals, rng) -> None:
    """Simulate what was asked, told in parts and in random order."""
    runs = []
    for p in proposals:
        try:
            runs += [(p.point, sample, m) for sample, m in zip(p.samples, f(p.x, p.P), strict=True)]
        except InfeasibleManeuver as infeasible:
            study.tell_infeasible(p.point, str(infeasible))
    for part in np.array_split(rng.permutation(len(runs)), 3):
        for p in proposals:
            mine = [runs[i] for i in part if runs[i][0] == p.point]
            study.tell(p.point, [run[1] for run in mine], np.array([run[2] for run in mine]))


@pytest.mark.slow
def test_ask_and_tell_gives_the_design_of_the_callable(tmp_path):
    study = Study.create(tmp_path / "study", OPERATION, UNKNOWN, "p", **ARGUMENTS)
    rng = np.random.default_rng(0)
    while proposals := study.ask():
        # f marks sample 3 as failed: ask for whole points, as the callable path runs them
        answer(study, proposals, rng)
        study = Study.open(tmp_path / "study")  # as after a kill
    assert_same(study.design(), by_call())


@pytest.mark.slow
def test_through_csv_files(tmp_path):
    study = Study.create(tmp_path / "study", OPERATION, UNKNOWN, "p", **ARGUMENTS)
    while study.ask():
        with (tmp_path / "study" / "pending.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        points = dict.fromkeys(row["point"] for row in rows)
        with (tmp_path / "told.csv").open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow(["output", "sample", "point"])
            for point in points:
                here = [row for row in rows if row["point"] == point]
                x = np.array([float(here[0][name]) for name in OPERATION])
                P = np.array([[float(row[name]) for name in UNKNOWN] for row in here])
                try:
                    outputs = ["failed" if np.isnan(m) else repr(float(m)) for m in f(x, P)]
                except InfeasibleManeuver as infeasible:
                    outputs = [f"infeasible: {infeasible}"] * len(here)
                for row, output in zip(here, outputs, strict=True):
                    writer.writerow([output, row["sample"], point])
        study.tell_csv(tmp_path / "told.csv")
    assert_same(study.design(), by_call())


@pytest.mark.slow
def test_a_killed_design_goes_on_where_it_was(tmp_path):
    arguments = {"workers": 1, "store": tmp_path / "study", **ARGUMENTS}
    calls = 0

    def counted(x, P):
        nonlocal calls
        calls += 1
        if calls == 25 and killing:
            raise KeyboardInterrupt
        return f(x, P)

    killing = True
    with pytest.raises(KeyboardInterrupt):
        design_excitation(counted, OPERATION, UNKNOWN, "p", **arguments)
    killing, calls = False, 0
    whole = design_excitation(
        counted, OPERATION, UNKNOWN, "p", **arguments | {"store": tmp_path / "other"}
    )
    in_all, calls = calls, 0
    assert_same(design_excitation(counted, OPERATION, UNKNOWN, "p", **arguments), whole)
    assert calls == in_all - 24
    calls = 0
    assert_same(design_excitation(counted, OPERATION, UNKNOWN, "p", **arguments), whole)
    assert calls == 0


@pytest.mark.slow
@pytest.mark.parametrize("cut", [1, 7, 30])
def test_a_line_cut_off_by_a_crash_is_asked_again(tmp_path, cut):
    path = tmp_path / "study"
    whole = by_call(store=path)
    results = path / "results.csv"
    results.write_bytes(results.read_bytes()[:-cut])
    study = Study.open(path)
    proposals = study.ask()
    assert sum(len(p.samples) for p in proposals) >= 1
    for p in proposals:
        study.tell(p.point, p.samples, f(p.x, np.vstack([p.P] * 40))[-len(p.P) :])
    assert_same(Study.open(path).design(), whole)


@pytest.mark.parametrize("name", ["p", "sample"])
def test_columns_of_one_name_are_refused(tmp_path, name):
    operation = {"a": (-1.0, 1.0), name: (0.0, 2.0)}
    with pytest.raises(DesignError, match=f"columns of a study would have one name: {name}"):
        Study.create(tmp_path / "study", operation, UNKNOWN, "q", **ARGUMENTS)
    assert not (tmp_path / "study").exists()


def test_outputs_are_never_overwritten(tmp_path):
    study = Study.create(tmp_path, OPERATION, UNKNOWN, "p", **ARGUMENTS)
    p = study.ask()[0]
    study.tell(p.point, [0], np.array([1.5]))
    study.tell(p.point, [0], np.array([1.5]))
    before = (tmp_path / "results.csv").read_bytes()
    for point, sample, message in [
        (p.point, 0, r"sample 0 has the output 1\.5 already"),
        (p.point, 12, "sample 12 was never asked for"),
        (999, 0, "point 999, sample 1 was never asked for"),
    ]:
        with pytest.raises(DesignError, match=message):
            study.tell(point, [1, sample], np.array([1.0, 2.0]))
        assert (tmp_path / "results.csv").read_bytes() == before
    with pytest.raises(DesignError, match="point 999 was never asked for"):
        study.tell_infeasible(999, "x")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("point,output\n0,1\n", "column sample is missing"),
        ("point,sample,output\n0,0,1\n0,1,fast\n", "line 3: .* output 'fast' must be numbers"),
        ("point,sample,output\nzero,0,1\n", "line 2: point 'zero'"),
        ("point,sample,output\n0,0,1,5\n", "line 2: has more cells than the header"),
        ("point,sample,output\n0,0,1\n99,0,infeasible: x\n", "point 99 was never asked for"),
        ("point,sample,output\n0,0,1\n0,1,infeasible: x\n", "point 0 has an output and is infeas"),
        ("point,sample,output,output\n0,0,1,2\n", "column output is there twice"),
        ("point,sample,output\n0,0,1\n0,1,-inf\n", r"line 3: output -inf: must be finite, or 'f"),
        (
            "point,sample,output\n0,0,infeasible: x\n0,1,infeasible: y\n",
            "line 3: point 0 is infeasible already: x",
        ),
    ],
)
def test_a_wrong_csv_changes_nothing(tmp_path, text, message):
    study = Study.create(tmp_path / "study", OPERATION, UNKNOWN, "p", **ARGUMENTS)
    study.ask()
    told = tmp_path / "told.csv"
    told.write_text(text)
    with pytest.raises(DesignError, match=message):
        study.tell_csv(told)
    assert not (tmp_path / "study" / "results.csv").exists()


@pytest.mark.parametrize("changed", [*OPERATION, *UNKNOWN])
@pytest.mark.parametrize("output", ["1", "failed", "infeasible: too fast", ""])
def test_outputs_of_other_parameters_are_refused(tmp_path, changed, output):
    study = Study.create(tmp_path / "study", OPERATION, UNKNOWN, "p", **ARGUMENTS)
    study.ask()
    with (tmp_path / "study" / "pending.csv").open(newline="") as file:
        row = next(csv.DictReader(file))
    asked = row[changed]

    def tell(value):
        text = (
            ",".join([*row, "output"])
            + "\n"
            + ",".join([*(row | {changed: value}).values(), output])
        )
        (tmp_path / "told.csv").write_text(text)
        study.tell_csv(tmp_path / "told.csv")

    for wrong in (repr(1.01 * float(asked) + 0.02), "nan", "x"):
        if output:
            with pytest.raises(
                DesignError, match=rf"told.csv, line 2: {changed} {wrong}, asked was {asked}"
            ):
                tell(wrong)
    assert not (tmp_path / "study" / "results.csv").exists()
    tell(f"{float(asked):.6g}")  # rounded by a program
    tell("")
    assert (tmp_path / "study" / "results.csv").exists() == bool(output)


def test_a_folder_of_outputs_and_parts_that_are_none_are_told(tmp_path):
    study = Study.create(tmp_path / "study", OPERATION, UNKNOWN, "p", **ARGUMENTS)
    with pytest.raises(DesignError, match=r"is a folder; a CSV file is needed$"):
        study.tell_csv(tmp_path)
    with pytest.raises(DesignError, match=r"^0 parts: needs 1 or more$"):
        study.pending(0, 0)


def test_what_is_known_of_a_point_is_not_contradicted(tmp_path):
    study = Study.create(tmp_path, OPERATION, UNKNOWN, "p", **ARGUMENTS)
    first, second = study.ask()[:2]
    study.tell(first.point, [0], np.array([1.0]))
    study.tell_infeasible(second.point, "too  fast")
    study.tell_infeasible(second.point, "too fast")
    before = (tmp_path / "results.csv").read_bytes()
    with pytest.raises(DesignError, match="has outputs already"):
        study.tell_infeasible(first.point, "too fast")
    with pytest.raises(DesignError, match="is infeasible already: too fast"):
        study.tell_infeasible(second.point, "too slow")
    with pytest.raises(DesignError, match="which"):
        study.tell(second.point, [0], np.array([1.0]))
    assert (tmp_path / "results.csv").read_bytes() == before


@pytest.mark.slow
@pytest.mark.parametrize("wrong", [0.0, True, 0.5, "0"])
def test_a_point_or_sample_that_is_no_whole_number_is_refused(tmp_path, wrong):
    study = Study.create(tmp_path, OPERATION, UNKNOWN, "p", **ARGUMENTS)
    study.ask()
    for point, sample in ((wrong, 0), (0, wrong)):
        with pytest.raises(DesignError, match="needs a whole number"):
            study.tell(point, [sample], np.zeros(1))
    study.tell(np.int64(0), np.array([0]), np.zeros(1))
    assert 0 not in Study.open(tmp_path).ask()[0].samples


def test_damage_is_met_by_every_call(tmp_path):
    study = Study.create(tmp_path, OPERATION, UNKNOWN, "p", **ARGUMENTS)
    study.ask()
    study.tell(0, [0], np.zeros(1))
    points, results = (tmp_path / name for name in ("points.csv", "results.csv"))
    whole = results.read_bytes(), points.read_bytes()
    with results.open("a") as file:
        file.write("0,xx,1.0\n")
    for _ in range(2):
        with pytest.raises(DesignError, match="are damaged"):
            study.ask()
    results.write_bytes(whole[0])
    points.unlink()
    with pytest.raises(DesignError, match=r"results\.csv has point 0, and points\.csv does not"):
        Study.open(tmp_path)
    points.write_bytes(whole[1])
    assert 0 not in study.ask()[0].samples
    (tmp_path / "study.json").unlink()
    with pytest.raises(DesignError, match=r"holds points\.csv, results\.csv of a study whose"):
        Study.create(tmp_path, OPERATION, UNKNOWN, "p", **ARGUMENTS)


def test_a_store_of_another_design_is_refused(tmp_path):
    by_call(store=tmp_path)
    with pytest.raises(DesignError, match=r"another design \(different: samples, seed\)"):
        by_call(store=tmp_path, seed=6, samples=13)
    with pytest.raises(DesignError, match="holds a study already"):
        Study.create(tmp_path, OPERATION, UNKNOWN, "p")


def test_a_study_of_another_version_is_refused(tmp_path):
    Study.create(tmp_path, OPERATION, UNKNOWN, "p")
    description = json.loads((tmp_path / "study.json").read_text())
    (tmp_path / "study.json").write_text(json.dumps(description | {"version": 3}))
    with pytest.raises(DesignError, match="study of version 3; this program reads 1 and 2"):
        Study.open(tmp_path)
    (tmp_path / "study.json").write_text("{")
    with pytest.raises(DesignError, match=r"study\.json: is not JSON"):
        Study.open(tmp_path)


def test_a_study_of_version_1_goes_on(tmp_path):
    """It knew the criterion H alone, and nothing of trajectories."""
    Study.create(tmp_path, OPERATION, UNKNOWN, "p", **ARGUMENTS)
    description = json.loads((tmp_path / "study.json").read_text())
    for new in ("criterion", "trajectory_noise", "draws", "prior", "nuisances"):
        del description[new]
    (tmp_path / "study.json").write_text(json.dumps(description | {"version": 1}))
    assert Study.open(tmp_path).ask()
    Store.of(tmp_path, Store.open(tmp_path).problem)


@pytest.mark.slow
def test_two_processes_tell_one_study(tmp_path):
    """Neither knows of the other but through the files, and nothing is told twice or lost."""
    asking = Study.create(tmp_path, OPERATION, UNKNOWN, "p", **ARGUMENTS)
    first, second = asking.ask()[:2]
    script = """
import sys
from pathlib import Path
import numpy as np
from excitation_planner import Study

study, point = Study.open(Path(sys.argv[1])), int(sys.argv[2])
sys.stdin.readline()
for sample in range(12):
    study.tell(point, [sample], np.array([point + sample / 12]))
"""
    tellers = [
        subprocess.Popen(
            [sys.executable, "-c", script, str(tmp_path), str(p.point)], stdin=subprocess.PIPE
        )
        for p in (first, second, second)  # two tell the same
    ]
    for teller in tellers:
        teller.communicate(b"go\n")
    assert [teller.returncode for teller in tellers] == [0, 0, 0]
    still = {p.point for p in asking.ask()}
    assert not still & {first.point, second.point}
    lines = (tmp_path / "results.csv").read_text().splitlines()
    assert len(lines) == len(set(lines)) == 1 + 2 * 12
    with pytest.raises(DesignError, match=r"has the output 0\.0 already"):
        asking.tell(0, [0], np.array([7.0]))


def test_no_study_and_noise_that_cannot_be_kept(tmp_path):
    with pytest.raises(DesignError, match="holds no study"):
        Study.open(tmp_path)
    with pytest.raises(DesignError, match="noise variance that is a number"):
        by_call(store=tmp_path, noise_variance=lambda m: 1.0)


def test_trajectory_error_noise_survives_the_disk(tmp_path):
    noise = TrajectoryErrorNoise(0.01, points=100)
    Study.create(tmp_path, OPERATION, UNKNOWN, "p", noise_variance=noise)
    assert json.loads((tmp_path / "study.json").read_text())["noise_variance"]["points"] == 100
    assert Study.open(tmp_path).ask()


def test_parts_of_what_is_pending(tmp_path):
    """Every simulation is in one part; what has been told is in none."""
    study = Study.create(tmp_path, OPERATION, UNKNOWN, "p", **ARGUMENTS)
    assert study.pending() == []
    asked = study.ask()
    told = asked[1]
    study.tell(told.point, told.samples[3:], np.arange(9.0))
    runs = [
        (p.point, sample, *p.x, *row)
        for part in range(5)
        for p in Study.open(tmp_path).pending(part, 5)
        for sample, row in zip(p.samples, p.P, strict=True)
    ]
    assert sorted(runs) == sorted(
        (p.point, sample, *p.x, *row)
        for p in asked
        for sample, row in zip(p.samples, p.P, strict=True)
        if p is not told or sample < 3
    )
    for part, parts in ((5, 5), (-1, 5)):
        with pytest.raises(DesignError, match=f"part {part} of {parts}: parts are numbered"):
            study.pending(part, parts)
    study.tell_infeasible(asked[0].point, "a wall")
    assert asked[0].point not in {p.point for p in study.pending()}
    (tmp_path / "pending.csv").write_text("point,sample\n0,zero\n")
    with pytest.raises(DesignError, match=r"pending\.csv: is damaged; ask again"):
        study.pending()
