"""Identification drive by drive: the same as of all drives at once, on any executor."""

import dataclasses
import errno
import os
import re
import shutil
import subprocess
import sys
import time
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from signal import SIGINT

import numpy as np
import pytest
from simulated_drives import NAMES, TRUTH, VEHICLE, driven, planned

from excitation_planner.design import jobs
from excitation_planner.design.jobs import versions
from excitation_planner.maneuver import Circle
from parameter_identification import many_drives, vehicle_fit
from parameter_identification.drives.imported import recording_of, write_bag
from parameter_identification.drives.kept import keep, load_kept, measured_in
from parameter_identification.drives.measured import Input, Sensor
from parameter_identification.drives.measured_from_bag import read_measured_drive
from parameter_identification.drives.samples import Samples
from parameter_identification.drives.simulated import SensorNoise
from parameter_identification.drives.table import SteeringMap
from parameter_identification.estimation.shares import DriveShare, FitSetting, share_of
from parameter_identification.identification import identify
from parameter_identification.many_drives import identify_many, result_of
from parameter_identification.vehicle_fit import (
    Variables,
    VehicleCost,
    VehicleFit,
    drop_without_inputs,
)
from parameter_identification.workers import each
from tricycle_cli.main import main
from tricycle_core.errors import IdentificationError
from tricycle_sim.effects import effects_of

SENSORS = {
    Sensor.HEADING: SensorNoise(0.002),
    Sensor.YAW_RATE: SensorNoise(0.005),
    Sensor.WHEEL_SPEED: SensorNoise(0.003),
}


def write(bag, number, *, truth=TRUTH):
    commands = planned(Circle(duration=6.0), 2.5 + 0.3 * (number % 5), 0.8)
    drive = driven(
        commands, noise=0.001, seed=number, truth=truth, others=SENSORS, standstill=1.0,
        name=bag.name,
    )  # fmt: skip
    write_bag(recording_of(drive), VEHICLE, SteeringMap(), bag)
    return bag


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bags")
    return [write(folder / f"drive_{i}", i) for i in range(4)]


@pytest.mark.slow
def test_it_is_the_identification_of_all_drives_at_once(bags, tmp_path):
    found = identify_many(bags, VEHICLE, folder=tmp_path)
    at_once = identify([read_measured_drive(bag, VEHICLE) for bag in bags], VEHICLE)
    for name, expected in at_once.parameters.items():
        estimate, std = found.parameters[name], expected.standard_deviation
        assert estimate.estimate == pytest.approx(expected.estimate, abs=0.05 * std), name
        assert estimate.standard_deviation == pytest.approx(std, rel=0.01), name
        assert estimate.linear == pytest.approx(expected.linear, abs=0.05 * std), name
        assert estimate.identifiable == expected.identifiable
    assert found.white == at_once.white
    (asked,) = (one := found.only(["yaw_inertia"])).parameters.values()
    assert asked == found.parameters["yaw_inertia"]
    assert one.covariance == pytest.approx(asked.standard_deviation**2)
    assert {"yaw_inertia", *one.others} == set(found.parameters)


OF_ALL = ("steering-zero", "wheel-radius")
OF_EACH = ("slope-or-wind-across", "turn-deviation")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effects", "weighed"), [(OF_ALL + OF_EACH, False), (OF_ALL, True)], ids=["acting", "weighed"]
)
def test_with_effects_it_is_that_of_all_drives_at_once(bags, tmp_path, effects, weighed):
    found = identify_many(bags, VEHICLE, folder=tmp_path, effects=effects, weighed=weighed)
    drives = [read_measured_drive(bag, VEHICLE) for bag in bags]
    at_once = identify(drives, VEHICLE, effects=effects, weighed=weighed)
    close = 0.1
    for name, expected in at_once.parameters.items():
        estimate, std = found.parameters[name], expected.standard_deviation
        assert estimate.estimate == pytest.approx(expected.estimate, abs=close * std), name
        assert estimate.standard_deviation == pytest.approx(std, rel=close), name
        assert estimate.identifiable == expected.identifiable
    shared = {e.name: e for e in at_once.effects if not e.drive and e.chance is None}
    assert {e.name for e in found.effects} - {"turn deviation"} == set(shared)
    for e in found.effects:
        if e.name in shared:
            expected = shared[e.name]
            assert e.standard_deviation == pytest.approx(expected.standard_deviation, rel=close)
            assert e.estimate == pytest.approx(
                expected.estimate, abs=close * expected.standard_deviation
            )
            if weighed:
                assert e.acts == pytest.approx(expected.acts, abs=0.05)


def assert_same(found, expected):
    for name, e in expected.parameters.items():
        assert found.parameters[name].estimate == pytest.approx(e.estimate, rel=1e-9)
        assert found.parameters[name].standard_deviation == pytest.approx(
            e.standard_deviation, rel=1e-9
        )


@pytest.mark.slow
def test_every_executor_finds_the_same(bags, tmp_path):
    here = identify_many(bags, VEHICLE, folder=tmp_path / "here")
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as executor:
        there = identify_many(bags, VEHICLE, folder=tmp_path / "there", executor=executor)
    assert_same(there, here)


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # dask's own
def test_dask_finds_the_same(bags, tmp_path):
    distributed = pytest.importorskip("distributed")
    here = identify_many(bags, VEHICLE, folder=tmp_path / "here")
    with distributed.Client(
        n_workers=2, threads_per_worker=1, dashboard_address=None, local_directory=str(tmp_path)
    ) as client:
        there = identify_many(
            bags, VEHICLE, folder=tmp_path / "there", executor=client.get_executor()
        )
    assert_same(there, here)


@pytest.mark.slow
def test_a_bag_that_was_read_is_not_read_again(bags, tmp_path, monkeypatch):
    first = identify_many(bags, VEHICLE, folder=tmp_path)

    def refused(*_, **__):
        raise AssertionError("read again")

    monkeypatch.setattr("parameter_identification.many_bags.read_measured_drive", refused)
    again = identify_many(bags, VEHICLE, folder=tmp_path)
    assert [e.estimate for e in again.parameters.values()] == [
        e.estimate for e in first.parameters.values()
    ]


def test_progress_goes_on_after_the_bags_are_read(bags, tmp_path, monkeypatch):
    monkeypatch.setattr(vehicle_fit, "TOLERANCE", 1e-8)  # so that a second pass is needed
    told = []
    identify_many(bags[:2], VEHICLE, folder=tmp_path, progress=lambda *step: told.append(step))
    assert told[:4] == [(1, 4), (2, 4), (4, 4), (6, 6)]
    assert all(done == total for done, total in told[2:])


@pytest.mark.slow
def test_drives_are_named_by_the_bags_that_are_given(bags, tmp_path, monkeypatch):
    work = tmp_path / "work"
    assert identify_many(bags[:1], VEHICLE, folder=work).drives[0].name == bags[0].name
    for vehicle, bag in zip("ab", bags, strict=False):
        shutil.copytree(bag, tmp_path / vehicle / "renamed")
    given = [tmp_path / "a" / "renamed", tmp_path / "b" / "renamed"]
    (alone,) = identify_many(given[:1], VEHICLE, folder=work).drives
    assert alone.name == "renamed"
    monkeypatch.chdir(tmp_path)
    for both in (given, [bag.relative_to(tmp_path) for bag in given]):
        named = [drive.name for drive in identify_many(both, VEHICLE, folder=work).drives]
        assert named == ["a/renamed", "b/renamed"]


@pytest.mark.parametrize(("limit", "shown"), [(vehicle_fit.LOST, False), (0.6, True)])
def test_of_drives_whose_own_variables_are_not_found_nothing_is_shown(
    bags, tmp_path, monkeypatch, limit, shown
):
    def given_up(setting, drive, *arguments):
        share = share_of(setting, drive, *arguments)
        return dataclasses.replace(share, converged=drive.name != "drive_0")

    monkeypatch.setattr(vehicle_fit, "LOST", limit)
    monkeypatch.setattr("parameter_identification.vehicle_fit.share_of", given_up)
    found = identify_many(bags[:2], VEHICLE, folder=tmp_path)
    assert [drive.name for drive in found.drives if not drive.converged] == ["drive_0"]
    assert found.converged == shown
    assert any(e.identifiable for e in found.parameters.values()) == shown


@pytest.mark.slow
def test_drives_of_different_vehicles_are_said_to_contradict_each_other(tmp_path):
    rng = np.random.default_rng(0)
    apart = [TRUTH * (1.0 + 0.03 * rng.standard_normal(len(TRUTH))) for _ in range(20)]
    bags = [write(tmp_path / f"drive_{i}", i, truth=truth) for i, truth in enumerate(apart)]
    found = identify_many(bags, VEHICLE, folder=tmp_path / "work")
    assert found.scatter > 1.5  # of one vehicle: about 1
    assert not found.white
    stiffness = found.parameters["cornering_stiffness"]
    values = np.array(apart)[:, 0]
    # as known as a mean of so many vehicles
    error = np.std(values, ddof=1) / np.sqrt(len(values))
    assert 0.4 * error < stiffness.standard_deviation < 2.5 * error
    assert stiffness.low < values.mean() < stiffness.high
    drives = [read_measured_drive(bag, VEHICLE) for bag in bags]
    together = identify(drives, VEHICLE, profiles=True, starts=1)
    stiffness = together.parameters["cornering_stiffness"]
    assert 0.4 * error < stiffness.standard_deviation < 2.5 * error
    assert stiffness.low < values.mean() < stiffness.high
    assert stiffness.profile is None
    assert together.scatter == pytest.approx(found.scatter, rel=0.25)


@pytest.mark.slow
def test_all_is_in_doubt_where_the_model_is_wrong_and_a_parameter_at_its_end(tmp_path):
    rng, below = np.random.default_rng(0), TRUTH.copy()
    rolling = list(VEHICLE.unknown).index("rolling_coefficient_1")
    below[rolling] = 0.5 * VEHICLE.unknown["rolling_coefficient_1"][0]
    apart = [below * (1.0 + 0.03 * rng.standard_normal(len(TRUTH))) for _ in range(4)]
    bags = [write(tmp_path / f"drive_{i}", i, truth=truth) for i, truth in enumerate(apart)]
    found = identify_many(bags, VEHICLE, folder=tmp_path / "work")
    assert not found.white
    assert not any(e.identifiable for e in found.parameters.values())


@pytest.mark.slow
def test_a_kept_drive_that_was_damaged_is_read_again(bags, tmp_path):
    first = identify_many(bags[:1], VEHICLE, folder=tmp_path)
    (file,) = tmp_path.iterdir()
    whole = file.read_bytes()
    for damaged in (b"", b"not a drive", whole[: len(whole) // 2]):
        file.write_bytes(damaged)
        assert_same(identify_many(bags[:1], VEHICLE, folder=tmp_path), first)
    file.write_bytes(whole.replace(b"PK\x03\x04", b"PK\x03\x05"))  # the list at the end is good
    with pytest.raises(IdentificationError, match="damaged: delete it"):
        load_kept(file)


@pytest.mark.slow
def test_a_full_disk_is_no_bad_bag(bags, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("parameter_identification.many_bags.keep", full)
    with pytest.raises(OSError, match="No space left"):
        identify_many(bags[:1], VEHICLE, folder=tmp_path, leave_out=True)


def test_a_copy_in_another_file_or_format_is_the_same_drive(bags, tmp_path):
    copy = tmp_path / "copy"
    shutil.copytree(bags[0], copy)
    with (copy / "metadata.yaml").open("a") as file:
        file.write("# copied\n")
    (inside,) = bags[0].glob("*.mcap")
    converted = tmp_path / "converted"
    options = "--output", str(converted), "--compression", "none"
    assert main(["bag", "convert", str(bags[0]), *options]) == 0
    for same in (copy, inside, converted):
        with pytest.raises(IdentificationError, match="are the same drive"):
            identify_many([bags[0], same], VEHICLE, folder=tmp_path / "work")


def test_a_copy_that_was_cut_is_the_same_drive(bags, tmp_path):
    cut = tmp_path / "cut"
    options = "--output", str(cut), "--duration", "6"
    assert main(["bag", "convert", str(bags[0]), *options]) == 0
    for both in ([bags[0], cut], [cut, bags[0]]):
        with pytest.raises(IdentificationError, match="are the same drive"):
            identify_many(both, VEHICLE, folder=tmp_path / "work")
    several = [*bags[:2], cut]
    found = identify_many(several, VEHICLE, folder=tmp_path / "work", leave_out=True)
    assert found.left_out == (f"{cut} and {bags[0]} are the same drive",)
    assert len(found.drives) == 2


def test_a_bag_that_was_cut_off_is_known_to_be(bags, tmp_path):
    torn = tmp_path / "torn"
    shutil.copytree(bags[0], torn)
    (inside,) = torn.glob("*.mcap")
    inside.write_bytes(inside.read_bytes()[:-50])
    found = identify_many([torn], VEHICLE, folder=tmp_path / "work")
    assert [drive.complete for drive in found.drives] == [False]


@pytest.mark.slow
def test_a_bad_bag_is_named_and_left_out_only_when_asked(bags, tmp_path):
    broken = tmp_path / "broken"
    shutil.copytree(bags[0], broken)
    for file in broken.glob("*.mcap"):
        file.write_bytes(b"not a bag")
    for extra in (broken, tmp_path / "nowhere", bags[0]):
        with pytest.raises(IdentificationError, match=extra.name):
            identify_many([*bags[:1], extra], VEHICLE, folder=tmp_path / "work")
    found = identify_many([*bags[:1], broken], VEHICLE, folder=tmp_path / "work", leave_out=True)
    assert len(found.drives) == 1
    assert len(found.left_out) == 1
    assert "broken" in found.left_out[0]
    with pytest.raises(IdentificationError, match="no drive"):
        identify_many([broken], VEHICLE, folder=tmp_path / "work", leave_out=True)


def test_a_drive_without_what_moves_as_measured_is_named_by_its_bag_or_left_out(
    bags, tmp_path, monkeypatch
):
    drive = read_measured_drive(bags[0], VEHICLE)
    silent = {s: v for s, v in drive.signals.items() if s is not Sensor.WHEEL_SPEED}
    for i, bag in enumerate(bags[:3]):
        keep(dataclasses.replace(drive, signals=silent) if i == 1 else drive, tmp_path / bag.name)
    files = {bag: tmp_path / bag.name for bag in bags[:3]}
    setting = FitSetting(VEHICLE, (), {}, {}, frozenset({Input.SPEED}))
    fit = VehicleFit(list(files.values()), setting, None, np.arange(3.0), TRUTH)
    monkeypatch.setattr(many_drives, "read_bags", lambda *_, **__: (files, []))
    monkeypatch.setattr(many_drives, "begin", lambda *_: [dataclasses.replace(fit)])
    reason = f"{bags[1]}: does not tell throughout the speed"
    with pytest.raises(IdentificationError, match=re.escape(reason)):
        identify_many(bags, VEHICLE, folder=tmp_path)
    (left_out,) = drop_without_inputs([fit], files, None, leave_out=True)
    assert left_out.startswith(reason)
    assert fit.files == [files[bags[0]], files[bags[2]]]
    assert fit.since.tolist() == [0.0, 2.0]


def test_a_drive_of_another_plan_is_taken_knowingly(bags, tmp_path, monkeypatch):
    def refuse(drive, vehicle):
        raise IdentificationError(f"{drive.name}: planned for another vehicle")

    monkeypatch.setattr("parameter_identification.many_bags.check_reference", refuse)
    kept = tmp_path / "work"
    assert len(identify_many(bags[:1], VEHICLE, folder=kept, other_vehicle=True).drives) == 1
    with pytest.raises(IdentificationError, match="another vehicle"):
        identify_many(bags[:1], VEHICLE, folder=kept)


def test_a_worker_that_dies_is_told(tmp_path):
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor:
        executor.submit(os._exit, 1)
        with pytest.raises(IdentificationError, match="a worker died"):
            identify_many([tmp_path], VEHICLE, folder=tmp_path / "work", executor=executor)


class Cancelling(Executor):
    """As of a scheduler that was lost."""

    def submit(self, *_, **__):
        (future := Future()).cancel()
        return future


def test_work_that_is_cancelled_is_told():
    with pytest.raises(IdentificationError, match=r"cancelled its work: .* The same call goes on"):
        list(each(Cancelling(), abs, [1]))


def _older():
    jobs.versions = lambda: (("tricycle-excitation", "0.0.9"), *versions()[1:])


def test_a_worker_of_another_version_gets_no_work(tmp_path):
    with (
        ProcessPoolExecutor(1, mp_context=get_context("spawn"), initializer=_older) as executor,
        pytest.raises(IdentificationError, match=r"has tricycle-excitation 0\.0\.9 instead of "),
    ):
        list(each(executor, Path.touch, [tmp_path / "worked"]))
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.filterwarnings("default")  # dask's own
def test_a_worker_of_dask_that_dies_is_told(tmp_path):
    distributed = pytest.importorskip("distributed")
    dask = pytest.importorskip("dask")
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 0}),
        distributed.Client(
            n_workers=1, threads_per_worker=1, dashboard_address=None, local_directory=str(tmp_path)
        ) as client,
        pytest.raises(IdentificationError, match="a worker died"),
    ):
        list(each(client.get_executor(), os._exit, [1]))


@pytest.mark.slow
@pytest.mark.parametrize("seconds", [0.0, 2.0])
def test_ctrl_c_ends_the_workers_without_a_word_of_theirs(bags, tmp_path, seconds):
    options = "--drive-by-drive", str(tmp_path / "work"), "--workers", "2"
    with subprocess.Popen(
        [Path(sys.executable).with_name("tricycle"), "identify", *map(str, bags), *options],
        start_new_session=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    ) as process:  # fmt: skip
        while process.poll() is None and not (tmp_path / "work").exists():
            time.sleep(0.01)
        time.sleep(seconds)  # 0: while the workers start
        os.killpg(process.pid, SIGINT)
        said, _ = process.communicate(timeout=20.0)  # until the last one that could say something
    assert "Traceback" not in said
    assert process.returncode == 130


@pytest.mark.parametrize(("logged_late", "low"), [((0.08, 0.08), -0.08), ((0.08, 0.0), 0.0)])
def test_steering_that_was_logged_late_allows_a_dead_time_below_0(
    tmp_path, monkeypatch, logged_late, low
):
    """As `identify` does: what each of the drives allows."""
    drive = driven(planned(Circle(duration=6.0), 2.5, 0.8), standstill=1.0)
    files = [tmp_path / f"{i}.npz" for i in range(2)]
    for file, late in zip(files, logged_late, strict=True):
        keep(dataclasses.replace(drive, steering_late=late), file)
    effects = effects_of(VEHICLE, ["servo-dead-time"])
    setting = FitSetting(VEHICLE, tuple(effects), {}, {})
    monkeypatch.setattr(many_drives, "_begin", lambda job: (setting, np.zeros(len(NAMES) + 1)))
    (fit,) = many_drives.begin([files], VEHICLE, effects, None, 0, None)
    assert fit.variables.low[-1] * effects[0].std == pytest.approx(low)


@pytest.mark.slow
def test_bags_of_tables_whose_steering_was_logged_late_are_fitted(tmp_path):
    bags = []
    for number in range(2):
        drive = driven(
            planned(Circle(duration=6.0), 2.5 + 0.3 * number, 0.8), noise=0.001, seed=number,
            others=SENSORS, standstill=1.0, name=f"{number}",
        )  # fmt: skip
        table = recording_of(drive)
        steering = Samples(table.steering.time + 0.05, table.steering.values)
        write_bag(
            dataclasses.replace(table, steering=steering),
            VEHICLE, SteeringMap(), bag := tmp_path / f"bag_{number}",
        )  # fmt: skip
        bags.append(bag)
    found = identify_many(bags, VEHICLE, folder=tmp_path, effects=["servo-dead-time"])
    (effect,) = found.effects
    assert effect.estimate == pytest.approx(-0.05, abs=0.005)


def test_a_kept_drive_is_the_one_that_was_kept(tmp_path):
    drive = driven(planned(Circle(duration=6.0), 2.5, 0.8), others=SENSORS, standstill=1.0)
    time = np.arange(0.0, 6.0, 0.01)
    drive = dataclasses.replace(
        drive,
        complete=False,
        began=1.5e9,
        steering_angle=Samples(time, np.sin(time)),
        vehicle_hash="abc",
        turn_std=1e-3,
        steering_late=0.08,
        pose_filter=0.15,
        unheard=(Sensor.MOTOR_TORQUE,),
    )
    keep(drive, tmp_path / "drive.npz")
    again = load_kept(tmp_path / "drive.npz")
    told = again.steering_angle
    assert np.array_equal([told.time, told.values], [time, np.sin(time)])
    fields = ("name", "truth", "complete", "began", "measured_throughout", "vehicle_hash")
    for field in (*fields, "turn_std", "steering_late", "pose_filter", "unheard"):
        assert getattr(again, field) == getattr(drive, field), field
    assert measured_in(tmp_path / "drive.npz") == {*drive.signals, Input.STEERING}
    for sensor, signal in drive.signals.items():
        assert np.array_equal(again.signals[sensor].time, signal.time)
        assert np.array_equal(again.signals[sensor].values, signal.values)
        assert again.signals[sensor].jitter == signal.jitter
    for name in ("time", "steering_motor_angle", "speed"):
        assert np.array_equal(getattr(again.commands, name), getattr(drive.commands, name))


@pytest.mark.parametrize(("pull", "shown"), [(2.0, True), (4.0, False)])
def test_an_effect_that_is_pulled_beyond_its_bound_counts_as_in_one_fit_of_all(pull, shown):
    k, n, std = len(VEHICLE.unknown), len(VEHICLE.unknown) + 1, 0.01
    setting = FitSetting(VEHICLE, effects_of(VEHICLE, ["wheel-radius"]), {}, {})
    prior = np.diag([*[12.0] * k, 1.0])
    low, high = np.append(np.zeros(k), -2.0), np.append(np.ones(k), 2.0)
    variables = Variables(low, high, np.append(np.full(k, 0.5), 0.0), prior)
    at, information = np.append(np.full(k, 0.5), 2.0), np.eye(n) * std**-2
    gradient = np.append(np.zeros(k), -pull * std * std**-2)
    share = DriveShare(
        "", 0.0, 1, at, 0.0, information, gradient, np.empty(0), white=False, truth={}
    )
    cost = VehicleCost(at, 0.0, gradient, information, gradient[None], 4 * (share,))
    files = {file: file for file in map(Path, "abcd")}
    fit = VehicleFit(list(files), setting, variables, np.zeros(4), at, cost)
    found = result_of(fit, files, (), 0.95, 0)
    assert {e.identifiable for e in found.parameters.values()} == {shown}
