"""What is found in a folder of results; what is damaged is refused."""

import dataclasses
import json
import shutil

import numpy as np
import pytest

from excitation_planner.plan import save_plan
from trajectory_recorder.bag.reader import BagReader
from trajectory_recorder.bag.writer import BagWriter
from tricycle_cli.main import main
from tricycle_cli.reports.run_folder import read_run
from tricycle_core.errors import IdentificationError, ReportError


def test_a_bag_is_shown_with_the_plan_that_was_driven_whatever_their_names(folder, plan, offset):
    (maneuver,) = read_run(folder).maneuvers
    assert maneuver.name == "designed"
    assert maneuver.plan.id == plan.id
    assert maneuver.judgement.te == pytest.approx(offset**2, rel=0.01)
    assert maneuver.te_expected == 0.00123
    assert np.all(maneuver.joints.wheel_rate == 2.0)
    assert maneuver.joints.time[0] == 0.0


def test_a_bag_with_other_names_of_topics_is_read_by_them(folder, capsys):
    bag = folder / "bags" / "recorded"
    shutil.move(bag, folder / "odom")
    renamed(folder / "odom", bag, {"/odom": "/localization/odometry"})
    shutil.rmtree(folder / "odom")
    (maneuver,) = read_run(bag).maneuvers
    assert "no topic odom" in maneuver.failure
    topics = ["--pose", "/localization/odometry"]
    assert main(["report", str(bag), "--output", str(folder / "r.html"), *topics]) == 0
    assert "no topic odom" not in (folder / "r.html").read_text()


def renamed(bag, output, names):
    """Write a bag anew with other names of topics."""
    with BagReader(bag) as reader, BagWriter(output) as writer:
        ids = {
            name: writer.add_topic(dataclasses.replace(topic, name=names.get(name, name)))
            for name, topic in reader.topics.items()
        }
        for message in reader.messages():
            writer.write(ids[message.topic], message.stamp, message.data)


def test_every_drive_and_every_plan_is_shown_under_a_name_of_its_own(plan, record_drive, tmp_path):
    reference = dataclasses.replace(plan.reference, x=plan.reference.x + 1e-6)
    other = dataclasses.replace(plan, reference=reference)
    for bag in ("bags/1", "bags/2", "day1/bag", "day2/bag"):  # one plan driven four times
        record_drive(tmp_path / bag)
    save_plan(plan, tmp_path / "plans" / "designed.json")
    found = {m.name: m for m in read_run(tmp_path).maneuvers}
    assert list(found) == ["bags/1", "bags/2", "day1/bag", "day2/bag"]
    assert all(m.plan.id == plan.id and m.judgement is not None for m in found.values())
    # without it, and with plans that were not driven
    (tmp_path / "plans" / "designed.json").unlink()
    for file in ("plans/1.json", "set/plan-1.json", "set/plan-2.json"):
        save_plan(other, tmp_path / file)
    names = [m.name for m in read_run(tmp_path).maneuvers]
    planned = ["plans/1.json", "plan-1", "plan-2"]
    assert names == [*planned, "bags/1", "2", "day1/bag", "day2/bag"]


def test_bags_of_one_file_and_those_of_a_killed_recorder_are_shown(record_drive, tmp_path):
    for name in ("whole", "killed", "single"):
        record_drive(tmp_path / "bags" / name)
    (tmp_path / "bags" / "killed" / "metadata.yaml").unlink()
    (tmp_path / "bags" / "single" / "single_0.mcap").rename(tmp_path / "drive.mcap")
    shutil.rmtree(tmp_path / "bags" / "single")
    found = {m.name: m.judgement for m in read_run(tmp_path).maneuvers}
    assert set(found) == {"whole", "killed", "drive.mcap"}
    assert None not in found.values()


def test_no_directory_is_told(tmp_path):
    with pytest.raises(ReportError, match="is not a directory"):
        read_run(tmp_path / "nowhere")


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("estimate", "x", r"\.estimate: needs a number, not a text"),
        ("range", [1, 2, 3], r"\.range: needs a list of length 2, not 3"),
        ("profile", {"values": [1, 2], "rise": [0]}, "a profile must be two lists of one length"),
        ("low", None, r"\.low: needs a number, not nothing"),
    ],
)
def test_a_damaged_identification_is_told(name, value, message, identified, tmp_path):
    document = json.loads(json.dumps(identified))
    document["parameters"]["cornering_stiffness"][name] = value
    (tmp_path / "identification.json").write_text(json.dumps(document))
    with pytest.raises(IdentificationError, match=message):
        read_run(tmp_path)


def test_an_identification_gets_the_truth_that_a_demo_noted(identified, tmp_path):
    folder = tmp_path / "identification"
    folder.mkdir()
    (folder / "identification.json").write_text(json.dumps(identified))
    noted = {"cornering_stiffness": {"truth": 1.0}, "yaw_inertia": {"truth": 51.0}}
    (tmp_path / "result.json").write_text(json.dumps({"parameters": noted}))
    ((name, found),) = read_run(tmp_path).identifications
    assert name == "identification"
    truth = {name: entry.truth for name, entry in found.parameters.items()}
    assert truth == {"cornering_stiffness": 600.0, "yaw_inertia": 51.0}  # its own where it has one
