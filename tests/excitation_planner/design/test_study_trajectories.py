"""Ask and tell for the criteria of whole trajectories, through files."""

import json
import shutil

import numpy as np
import pytest

from excitation_planner import (
    Box,
    BoxPrior,
    ManeuverSet,
    Study,
    TrajectoryNoise,
    design_excitation,
)
from excitation_planner.design.prior import NuisanceParameters
from excitation_planner.design.study_trajectories import read_trajectories, write_trajectories
from tricycle_core.errors import DesignError, InfeasibleManeuver

pa = pytest.importorskip("pyarrow")
parquet = pytest.importorskip("pyarrow.parquet")

OPERATION = {"frequency": (0.5, 3.0), "amplitude": (0.1, 1.0)}
UNKNOWN = {"mass": (0.8, 1.2), "damping": (0.2, 0.6)}
TIME = np.linspace(0.0, 4.0, 21)
ARGUMENTS = {
    "trajectory_noise": TrajectoryNoise(std=0.02, period=0.2, bias_std=0.01),
    "draws": 2,
    "samples": 8,
    "budget": 340,
    "seed": 3,
}


def f(x, P):
    """Position and speed of a driven mass; one sample fails, one corner cannot be driven."""
    frequency, amplitude = x
    if frequency > 2.9 and amplitude > 0.9:
        raise InfeasibleManeuver("too fast")
    mass, damping = P[:, :1], P[:, 1:2]
    phase = np.arctan2(damping, mass * frequency)
    gain = amplitude / np.hypot(mass * frequency**2, damping * frequency)
    Y = np.stack(
        [
            gain * np.sin(frequency * TIME - phase),
            gain * frequency * np.cos(frequency * TIME - phase),
            0.1 * mass * TIME,
        ],
        axis=-1,
    )
    Y += 0.01 * P[:, 2:].sum(axis=1)[:, None, None]
    Y[P[:, 0] > 1.19] = np.nan
    return Y


def assert_same(one, other):
    assert np.array_equal(one.x, other.x)
    assert one.cost == other.cost
    assert one.cost_interval == other.cost_interval
    assert [e.cost for e in one.history] == [e.cost for e in other.history]
    assert (one.simulations, one.failed) == (other.simulations, other.failed)
    assert np.array_equal(one.main, other.main)


def by_call(f=f, operation=OPERATION, **arguments):
    return design_excitation(
        f, operation, UNKNOWN, **{"target": "damping", "workers": 1} | ARGUMENTS | arguments
    )


def answered(path, study, f=f):
    """Run a study to its end, in parts, opened again before every part."""
    while proposals := study.ask():
        for p in proposals:
            try:
                Y = f(p.x, p.P)
            except InfeasibleManeuver as infeasible:
                study.tell_infeasible(p.point, str(infeasible))
                continue
            for part in np.array_split(np.arange(len(p.samples))[::-1], 2):
                samples = [p.samples[i] for i in part]
                here = tuple(y[part] for y in Y) if isinstance(Y, tuple) else Y[part]
                study.tell(p.point, samples, here)
        study = Study.open(path)
    return study.design()


@pytest.mark.parametrize(
    "criterion",
    ["c", pytest.param("d", marks=pytest.mark.slow), pytest.param("a", marks=pytest.mark.slow)],
)
def test_ask_and_tell_gives_the_design_of_the_callable(tmp_path, criterion):
    arguments = {"criterion": criterion, "target": "damping" if criterion == "c" else None}
    study = Study.create(tmp_path, OPERATION, UNKNOWN, **ARGUMENTS | arguments)
    assert_same(answered(tmp_path, study), by_call(**arguments))


def test_with_a_prior_and_parameters_beside(tmp_path):
    arguments = {
        "criterion": "c",
        "target": "mass",
        "prior": BoxPrior(np.array([0.4, 0.6]), np.array([[0.05, 0.01], [0.01, 0.04]])),
        "nuisances": NuisanceParameters((0.1, 0.1), own=1),
        "budget": 500,
    }
    study = Study.create(tmp_path, OPERATION, UNKNOWN, **ARGUMENTS | arguments)
    header = study.ask() and (tmp_path / "pending.csv").read_text().splitlines()[0]
    assert header == "point,sample,frequency,amplitude,mass,damping,nuisance0,nuisance1"
    assert_same(answered(tmp_path, study), by_call(**arguments))


def test_a_set_of_maneuvers(tmp_path):
    box = Box.of(OPERATION)
    pair = ManeuverSet((f, lambda x, P: f(x, P)[:, :11]), (box, box))
    noise = TrajectoryNoise(std=0.02, period=0.2)
    arguments = {"criterion": "d", "target": None, "trajectory_noise": noise}
    study = Study.create(tmp_path, pair.operation, UNKNOWN, **ARGUMENTS | arguments)
    whole = by_call(pair, pair.operation, **arguments)
    assert_same(answered(tmp_path, study, pair), whole)


def test_a_design_keeps_its_trajectories_and_goes_on(tmp_path):
    calls = 0

    def counted(x, P):
        nonlocal calls
        calls += len(P)
        if killing and calls > 150:
            raise KeyboardInterrupt
        return f(x, P)

    killing = True
    with pytest.raises(KeyboardInterrupt):
        by_call(counted, criterion="c", store=tmp_path, chunk=2)
    killing, before, calls = False, calls, 0
    whole = by_call(criterion="c")
    assert_same(by_call(counted, criterion="c", store=tmp_path, chunk=3), whole)
    assert calls <= whole.simulations + 12 - (before - 2) + 2 * 3  # no chunk but the broken one
    assert_same(Study.open(tmp_path).design(), whole)  # the same files
    calls = 0
    assert_same(by_call(counted, criterion="c", store=tmp_path), whole)
    assert calls == 0


def test_trajectories_told_by_a_file(tmp_path):
    """The file of a program that knows neither this suite nor maneuvers of a set."""
    study = Study.create(tmp_path / "study", OPERATION, UNKNOWN, "mass", criterion="a", **ARGUMENTS)
    told = tmp_path / "told.parquet"
    while proposals := study.ask():
        columns = {"sample": [], "v": [], "p": [], "q": [], "point": []}
        for p in proposals:
            try:
                Y = f(p.x, p.P)
            except InfeasibleManeuver as infeasible:
                text = f"point,sample,output\n{p.point},0,infeasible: {infeasible}\n"
                (tmp_path / "told.csv").write_text(text)
                study.tell_csv(tmp_path / "told.csv")
                continue
            for sample, y in zip(p.samples, Y, strict=True):
                columns["point"] += [float(p.point)] * len(TIME)
                columns["sample"] += [float(sample)] * len(TIME)
                for name, values in zip("vpq", y.T, strict=True):
                    columns[name] += values.tolist()
        parquet.write_table(pa.table(columns), told)
        study.tell_parquet(told)
    assert_same(study.design(), by_call(criterion="a", target="mass"))


def test_failed_without_a_trajectory(tmp_path):
    study = Study.create(tmp_path, OPERATION, UNKNOWN, "mass", criterion="c", **ARGUMENTS)
    first, second = study.ask()[:2]
    rows = [f"{first.point},0,failed"] + [f"{second.point},{s},failed" for s in second.samples]
    (tmp_path / "told.csv").write_text("\n".join(["point,sample,output", *rows]))
    study.tell_csv(tmp_path / "told.csv")
    (tmp_path / "number.csv").write_text("point,sample,output\n0,1,0.5\n")
    with pytest.raises(DesignError, match=r"needs the trajectory of point 0, sample 1, not a num"):
        study.tell_csv(tmp_path / "number.csv")
    study.tell(first.point, first.samples[1:], f(first.x, first.P)[1:])

    def fails(x, P):
        Y = f(x, P)
        Y[: 1 if np.array_equal(x, first.x) else None] = np.nan
        return Y if np.array_equal(x, first.x) or np.array_equal(x, second.x) else f(x, P)

    assert_same(answered(tmp_path, study, fails), by_call(fails, criterion="c", target="mass"))


def test_what_is_known_is_not_contradicted(tmp_path, monkeypatch):
    study = Study.create(tmp_path, OPERATION, UNKNOWN, "mass", criterion="c", **ARGUMENTS)
    p = study.ask()[0]
    Y = f(p.x, p.P)
    study.tell(p.point, p.samples[:2], Y[:2])
    study.tell(p.point, p.samples[1:3], Y[1:3])  # one again, one new
    before = (tmp_path / "results.csv").read_bytes()
    for samples, told, message in [
        ([0], Y[:1] + 1, "sample 0 has the output '.*parquet' already"),
        ([3], Y[3:4, :5], "point 0 has trajectories of 21x3 time points and channels, not 5x3"),
        ([99], Y[3:4], "sample 99 was never asked for"),
        ([3], Y[3], "criterion c needs a trajectory"),
        ([3], Y[3:4, :0], "criterion c needs a trajectory"),
        ([3, 3], Y[[3, 3]], "a sample is told twice"),
        ([3], (Y[3:4], Y[3:4, :, :2]), "point 0 has trajectories of 21x3"),
    ]:
        with pytest.raises(DesignError, match=message):
            study.tell(p.point, samples, told)
        assert (tmp_path / "results.csv").read_bytes() == before
    with pytest.raises(DesignError, match="has outputs already"):
        study.tell_infeasible(p.point, "x")
    other = study.ask()[1]
    with pytest.raises(DesignError, match=r"maneuvers have \[2, 3\] channels"):
        study.tell(other.point, [0], (Y[:1], Y[:1, :, :2]))
    with pytest.raises(DesignError, match="say why"):
        study.tell_infeasible(other.point, " ")
    monkeypatch.setattr("excitation_planner.design.study_trajectories.MAX_VALUES", 100)
    with pytest.raises(DesignError, match="more than 100 numbers: tell fewer"):
        study.tell(other.point, [0], Y[:1])


def test_channels_have_the_names_and_the_order_of_the_first_file(tmp_path):
    study = Study.create(tmp_path / "s", OPERATION, UNKNOWN, "mass", criterion="c", **ARGUMENTS)
    first, second, third = study.ask()[:3]
    told = tmp_path / "told.parquet"

    def tell(p, names):
        y = dict(zip("vpq", f(p.x, p.P)[0].T, strict=True))
        keys = {"point": [p.point] * len(TIME), "sample": [0] * len(TIME)}
        parquet.write_table(pa.table(keys | {name: y[name] for name in names}), told)
        study.tell_parquet(told)

    tell(first, "vpq")
    for names, named in (("pvq", "p, v, q"), ("vp", "v, p")):
        with pytest.raises(DesignError, match=f"channels are v, p, q, in this order, not {named}"):
            tell(second, names)
    tell(second, "vpq")
    study.tell(third.point, [0], f(third.x, third.P)[:1])  # without names


def test_files_that_are_none(tmp_path):
    path = tmp_path / "told.parquet"
    for content in (b"", b"PAR1", b"PAR1" + b"x" * 100 + b"PAR1"):
        path.write_bytes(content)
        with pytest.raises(DesignError, match=r"told\.parquet: is not a Parquet file"):
            read_trajectories(path)
    for columns, message in [
        ({"point": [0], "x": [1.0]}, "column sample is missing"),
        ({"point": [0], "sample": [0]}, "column of a channel is missing"),
        ({"point": [0.5], "sample": [0], "x": [1.0]}, "point must be whole numbers"),
        ({"point": [0], "sample": [0], "x": ["a"]}, "column x must be numbers"),
        ({"point": [0], "sample": [0], "__index_level_0__": [1.0]}, "with index=False"),
        ({"point": [0] * 3, "sample": [0, 0, 1], "x": [1.0] * 3}, "same number of time points"),
    ]:
        parquet.write_table(pa.table(columns), path)
        with pytest.raises(DesignError, match=message):
            read_trajectories(path)
    twice = pa.Table.from_arrays([pa.array([0])] * 4, names=["point", "sample", "y", "y"])
    parquet.write_table(twice, path)
    with pytest.raises(DesignError, match="a column is there twice"):
        read_trajectories(path)


def test_a_cut_off_file_is_named(tmp_path):
    study = Study.create(tmp_path, OPERATION, UNKNOWN, "mass", criterion="c", **ARGUMENTS)
    p = study.ask()[0]
    study.tell(p.point, p.samples, f(p.x, p.P))
    (file,) = (tmp_path / "trajectories").iterdir()
    file.write_bytes(file.read_bytes()[:-20])
    with pytest.raises(DesignError, match=f"{file.name}: is not a Parquet file"):
        Study.open(tmp_path).ask()
    text = (tmp_path / "results.csv").read_text().replace(file.name, "../../etc/passwd")
    (tmp_path / "results.csv").write_text(text)
    with pytest.raises(DesignError, match="is not a file of trajectories"):
        Study.open(tmp_path)


def test_the_file_gives_back_every_bit(tmp_path):
    rng = np.random.default_rng(0)
    outputs = (rng.standard_normal((3, 5, 2)), rng.standard_normal((3, 4, 2)))
    outputs[0][1, 2:] = np.nan
    write_trajectories(tmp_path / "a.parquet", 7, [4, 0, 9], outputs)
    ((point, (samples, read)),) = read_trajectories(tmp_path / "a.parquet").items()
    assert (point, samples) == (7, [0, 4, 9])
    for wrote, got in zip(outputs, read, strict=True):
        assert wrote[[1, 0, 2]].tobytes() == got.tobytes()


def test_another_problem_is_refused(tmp_path):
    study = Study.create(tmp_path / "a", OPERATION, UNKNOWN, "mass", criterion="c", **ARGUMENTS)
    assert study.ask()
    with pytest.raises(DesignError, match=r"another design \(different: criterion\)"):
        by_call(criterion="a", target="mass", store=tmp_path / "a")
    description = json.loads((tmp_path / "a" / "study.json").read_text())
    description["nuisances"]["steps"] = [0.0]
    shutil.copytree(tmp_path / "a", tmp_path / "b")
    (tmp_path / "b" / "study.json").write_text(json.dumps(description))
    with pytest.raises(DesignError, match="must be finite and not zero"):
        Study.open(tmp_path / "b")
