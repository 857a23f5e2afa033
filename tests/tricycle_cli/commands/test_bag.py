"""`tricycle bag`: what a bag holds, and its recovery."""

import json

import pytest
from mcap.writer import Writer

from trajectory_recorder.bag.topics import OfferedQos, Topic
from trajectory_recorder.bag.writer import BagWriter
from tricycle_core.errors import BagError


def test_bag_info(tricycle, bag, capsys):
    assert tricycle("bag", "info", bag, "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert found.pop("bytes") == (bag / "bag_0.mcap").stat().st_size
    assert [found.pop(key) for key in ("start", "end", "duration")] == pytest.approx(
        [0.0, 99e-9, 99e-9]
    )
    assert found == {
        "bag": str(bag),
        "storage": "mcap",
        "files": ["bag_0.mcap"],
        "complete": True,
        "messages": 100,
        "metadata": {"plan_id": "p1"},
        "topics": {"/chatter": {"type": "std_msgs/msg/String", "messages": 100}},
    }
    assert tricycle("bag", "info", bag) == 0
    text = capsys.readouterr().out
    assert "/chatter" in text
    assert "plan_id: p1" in text
    assert "duration  " in text


def test_names_are_whole_at_80_columns(tricycle, tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    latched = (OfferedQos(durability="transient_local"),)
    with BagWriter(tmp_path / "bag") as writer:
        for name, kind, qos in (
            ("/maneuver/planned_start", "geometry_msgs/msg/PoseStamped", latched),
            ("/maneuver/twist", "trajectory_msgs/msg/MultiDOFJointTrajectory", latched),
            ("/odom", "nav_msgs/msg/Odometry", (OfferedQos(),)),
        ):
            writer.add_topic(Topic.of_type(name, kind, qos=qos))
    assert tricycle("bag", "info", tmp_path / "bag") == 0
    rows = [line.split(maxsplit=3) for line in capsys.readouterr().out.splitlines()]
    assert ["0", "/maneuver/planned_start", "geometry_msgs/PoseStamped"] in [r[:3] for r in rows]
    assert ["0", "/odom", "nav_msgs/Odometry"] in rows
    twist = next(row for row in rows if "/maneuver/twist" in row)
    assert twist[2] == "trajectory_msgs/MultiDOFJointTrajectory"
    assert twist[3] == "latched"


def test_bag_convert_keeps_what_is_wanted(tricycle, bag, tmp_path, capsys):
    part = tmp_path / "part"
    assert tricycle("bag", "convert", bag, "--output", part, "--json") == 0
    assert json.loads(capsys.readouterr().out) == {"bag": str(part), "messages": 100}
    assert tricycle("bag", "convert", bag, part, "--output", tmp_path / "both") == 0
    assert "200 messages" in capsys.readouterr().out


def test_bag_recover(tricycle, bag, tmp_path, capsys):
    file = bag / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[:9000])
    assert tricycle("bag", "info", bag) == 0
    assert "cut off" in capsys.readouterr().out
    assert tricycle("bag", "convert", bag, "--output", tmp_path / "part") == 0
    assert f"{bag}: not whole" in capsys.readouterr().err
    assert tricycle("bag", "recover", bag, "--output", tmp_path / "new", "--json") == 0
    output, errors = capsys.readouterr()
    messages = json.loads(output)["messages"]
    assert 0 < messages < 100
    assert f"{bag}: not whole" in errors
    assert tricycle("bag", "info", tmp_path / "new", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["complete"], found["messages"]) == (False, messages)


@pytest.mark.parametrize("torn", [0, 20])
@pytest.mark.parametrize("verb", ["convert", "recover"])
def test_attachments_are_not_copied_and_that_is_told(tricycle, tmp_path, capsys, verb, torn):
    bag = tmp_path / "bag.mcap"
    with bag.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/chatter", "cdr", schema)
        writer.add_attachment(0, 0, "camera.yaml", "text/plain", b"a: 1")
        writer.add_message(channel, 0, b"", 0)
        writer.finish()
    bag.write_bytes(bag.read_bytes()[: bag.stat().st_size - torn])
    assert tricycle("bag", verb, bag, "--output", tmp_path / "new") == 0
    assert f"{bag}: attachments, which are not copied: 1" in capsys.readouterr().err


def test_damaged_chunks_are_left_out(tricycle, bag, tmp_path, capsys):
    file = bag / "bag_0.mcap"
    content = bytearray(file.read_bytes())
    content[content.index(bytes(50))] ^= 1  # within a message
    file.write_bytes(bytes(content))
    (bag / "metadata.yaml").write_bytes(b"")  # as a power cut may leave it
    assert tricycle("bag", "recover", bag, "--output", tmp_path / "new", "--json") == 0
    output, errors = capsys.readouterr()
    assert json.loads(output)["messages"] == 99
    assert json.loads(output)["damaged_chunks"] == 1
    assert "left out: " in errors


@pytest.mark.parametrize(
    ("arguments", "error", "reason"),
    [
        (("bag", "info", "nowhere"), BagError, "no such bag"),
        (
            ("bag", "convert", "{bag}", "--output", "{bag}-new", "--topics", "/nothing"),
            BagError,
            "no topic of the bag is /nothing; there are: /",
        ),
        (
            ("bag", "convert", "{bag}", "--output", "{bag}-new", "--exclude", "/chater"),
            BagError,
            r"no topic of the bag is /chater; did you mean /chatter\?$",
        ),
        (
            ("bag", "convert", "{bag}", "--output", "s3://bucket/part?X-Amz-Signature=secret"),
            BagError,
            "^s3://…: bags are written on this computer only; copy it there then$",
        ),
        (
            ("bag", "recover", "{bag}", "--output", "{bag}"),
            BagError,
            "exists: a bag is not overwritten",
        ),
    ],
)
def test_mistakes(tricycle, bag, arguments, error, reason):
    with pytest.raises(error, match=reason):
        tricycle(*(argument.format(bag=bag) for argument in arguments))
