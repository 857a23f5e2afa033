"""`tricycle drive`: what it refuses before it starts a node."""

import contextlib

import numpy as np
import pytest

from excitation_planner.plan import save_plan
from trajectory_recorder.bag.topics import Topic
from trajectory_recorder.bag.writer import BagWriter
from tricycle_cli.main import main
from tricycle_cli.operation import session
from tricycle_core.errors import InfeasibleManeuver, NodeError
from tricycle_sim.vehicle import load_vehicle


@pytest.fixture
def start(monkeypatch):
    """Has `tricycle drive` fail with "started" where it would start nodes."""

    def started(**_):
        raise NodeError("started")

    monkeypatch.setattr(session, "simulated_session", started)


@pytest.fixture
def line(plan, tmp_path, monkeypatch, start):
    """Drives the plan on a vehicle that differs from its own in some values."""
    save_plan(plan, tmp_path / "plan.json")

    def drive(*options, **values):
        vehicle = load_vehicle().replace(**values)
        monkeypatch.setattr("tricycle_cli.commands.drive.load_vehicle", lambda _: vehicle)
        return main(
            ["drive", str(tmp_path / "plan.json"), "--bag", str(tmp_path / "bag"), *options]
        )

    return drive


def test_a_plan_of_another_vehicle_is_refused_by_what_shapes_it(line, capsys):
    assert line(com_to_front_axle=1.25, mass=150.0) == 2
    errors = capsys.readouterr().err
    assert "com_to_front_axle" in errors
    assert "instead of 1.25" in errors
    assert "mass 48.3 instead of 150" in errors  # identification would refuse the drive
    assert "--other-vehicle" in errors


def test_estimates_and_effects_may_differ(line, capsys):
    assert line(cornering_stiffness=900.0, air_drag=0.9) == 2
    assert "started" in capsys.readouterr().err


def test_another_vehicle_is_taken_knowingly(line, capsys):
    assert line("--other-vehicle", com_to_front_axle=1.25) == 2
    assert "started" in capsys.readouterr().err


def test_a_bag_that_exists_is_refused_at_once(line, tmp_path, capsys):
    (tmp_path / "bag").mkdir()
    assert line() == 2
    assert f"{tmp_path / 'bag'} exists" in capsys.readouterr().err


def test_repeats_and_mirror_images_take_turns_and_each_has_a_bag(line, monkeypatch, tmp_path):
    driven = []

    @contextlib.contextmanager
    def session_of(**_):
        yield lambda plan, bag, _: driven.append((bag, plan))

    monkeypatch.setattr(session, "simulated_session", session_of)
    assert line("--repeat", "2", "--mirror") == 0
    names = ["1", "1-mirrored", "2", "2-mirrored"]
    assert [bag for bag, _ in driven] == [tmp_path / "bag" / name for name in names]
    left, right = (plan.commands.steering_motor_angle for _, plan in driven[:2])
    np.testing.assert_array_equal(left, -right)


def test_an_interrupted_series_goes_on_with_what_is_missing(
    line, record_drive, monkeypatch, tmp_path, capsys
):
    driven = []
    drive = contextlib.nullcontext(lambda _, bag, __: driven.append(bag.name))
    monkeypatch.setattr(session, "simulated_session", lambda **_: drive)
    for name in ("1", "2"):
        record_drive(tmp_path / "bag" / name)
    assert line("--repeat", "4") == 0
    assert driven == ["3", "4"]
    assert "bag holds the drives 1, 2: going on" in capsys.readouterr().out
    assert line("--repeat", "2") == 2
    assert f"{tmp_path / 'bag'} exists: a bag is not overwritten" in capsys.readouterr().err


@pytest.mark.parametrize(("inside", "given"), [(".", "."), ("1", "..")])
def test_a_series_is_continued_from_inside_its_folder(
    line, record_drive, monkeypatch, tmp_path, inside, given
):
    folders = []
    driven = contextlib.nullcontext(lambda *_: None)

    def session_of(*, folder, back, **_):
        folders.extend((folder, back))
        return driven

    monkeypatch.setattr(session, "simulated_session", session_of)
    record_drive(tmp_path / "bag" / "1")
    monkeypatch.chdir(tmp_path / "bag" / inside)
    assert line("--repeat", "2", "--return", "--bag", given) == 0
    assert folders == [tmp_path / "bag.session", tmp_path / "bag.way_back"]


@pytest.mark.parametrize(
    ("end", "options", "why"),
    [
        ("aborted", (), "{bag}: the maneuver was aborted"),
        ("running", (), "{bag}: the drive is not whole: move it away"),
        ("done", ("--mirror",), "{bag} is a drive of plan "),
    ],
)
def test_a_bag_of_a_series_that_is_no_whole_drive_is_named(
    line, plan, record_drive, tmp_path, capsys, end, options, why
):
    bag = tmp_path / "bag" / ("1-mirrored" if options else "1")
    record_drive(bag, end=end)
    assert line("--repeat", "2", *options) == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert said.startswith("tricycle: " + why.format(bag=bag))
    assert said.endswith("move it away, and the same command drives it again, and those that "
                         "are missing")  # fmt: skip


@pytest.mark.parametrize(
    ("topic", "option"),
    [("/odom", ""), ("/a/odom", ""), ("/pose/filtered", " --pose /pose/filtered")],
)
def test_the_command_that_judges_a_bag_names_its_poses(
    line, monkeypatch, tmp_path, capsys, topic, option
):
    def drive(plan, bag, _):
        with BagWriter(bag) as writer:
            writer.write(writer.add_topic(Topic(topic, "nav_msgs/msg/Odometry")), 1, b"")

    monkeypatch.setattr(session, "simulated_session", lambda **_: contextlib.nullcontext(drive))
    assert line() == 0
    assert f"tricycle judge {tmp_path / 'bag'}{option}\n" in capsys.readouterr().out


def test_a_plan_is_driven_once_at_least(line, capsys):
    assert line("--repeat", "0") == 2
    assert "--repeat 0" in capsys.readouterr().err


def test_a_plant_that_is_not_installed_is_refused_before_a_node_starts(line, capsys):
    assert line("--plant", "foo") == 2
    assert "unknown plant 'foo'; there are: own" in capsys.readouterr().err


def test_a_mirror_image_that_cannot_be_driven_is_one_line(line, monkeypatch, tmp_path, capsys):
    def mirrored(*_):
        raise InfeasibleManeuver("mirrored: needs 1.0 m more room in the area")

    monkeypatch.setattr("excitation_planner.planning.mirror.mirrored", mirrored)
    assert line("--mirror") == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert said == (
        f"tricycle: {tmp_path / 'plan.json'}: mirrored: needs 1.0 m more room in the area; "
        "leave out --mirror"
    )


def test_the_way_back_of_an_earlier_drive_is_not_replaced(line, tmp_path, capsys):
    earlier = tmp_path / "bag.way_back" / "bag"
    earlier.mkdir(parents=True)
    assert line("--return") == 2
    assert f"{earlier} exists" in capsys.readouterr().err
    assert line("--return", "--repeat", "2") == 2  # its last drive is another one
    assert "started" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--plant own", "--true-seed 0", "--real-time-factor 1"])
def test_an_option_of_the_simulation_is_refused_where_none_is_started(line, option, capsys):
    assert line("--vehicle-nodes", *option.split()) == 2
    (said,) = capsys.readouterr().err.splitlines()
    assert said.startswith(f"tricycle: {option.split()[0]}: of a simulation")
