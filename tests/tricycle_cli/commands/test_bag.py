"""The commands judge, bag, record and replay, as a user types them."""

import argparse
import json
from importlib import import_module
from pathlib import Path

import pytest

from trajectory_recorder.bag.topics import OfferedQos, Topic
from trajectory_recorder.bag.writer import BagWriter, Compression
from tricycle_core.errors import BagError, JudgeError


def tricycle(*arguments: object) -> int:
    parser = argparse.ArgumentParser()
    subparsers = parser.add_subparsers()
    for name in ("judge", "bag", "record", "replay"):
        import_module(f"tricycle_cli.commands.{name}").add_parser(subparsers)
    args = parser.parse_args([str(argument) for argument in arguments])
    status: int = args.run(args)
    return status


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    with BagWriter(
        tmp_path / "bag", metadata={"plan_id": "p1"}, compression=Compression.NONE
    ) as writer:
        topic = writer.add_topic(
            Topic.of_type("/chatter", "std_msgs/msg/String", qos=(OfferedQos(),))
        )
        for stamp in range(100):
            writer.write(topic, stamp, bytes(100))
            writer.flush()
    return tmp_path / "bag"


def test_bag_info(bag: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert tricycle("bag", "info", bag, "--json") == 0
    assert json.loads(capsys.readouterr().out) == {
        "bag": str(bag),
        "complete": True,
        "messages": 100,
        "metadata": {"plan_id": "p1"},
        "topics": {"/chatter": {"type": "std_msgs/msg/String", "messages": 100}},
    }
    assert tricycle("bag", "info", bag) == 0
    text = capsys.readouterr().out
    assert "/chatter" in text
    assert "plan_id: p1" in text


def test_bag_recover(bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = bag / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[:9000])
    assert tricycle("bag", "info", bag) == 0
    assert "cut off" in capsys.readouterr().out
    assert tricycle("bag", "recover", bag, tmp_path / "new", "--json") == 0
    messages = json.loads(capsys.readouterr().out)["messages"]
    assert 0 < messages < 100
    assert tricycle("bag", "info", tmp_path / "new", "--json") == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["complete"], found["messages"]) == (True, messages)


def test_damaged_chunks_are_left_out(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = bag / "bag_0.mcap"
    content = bytearray(file.read_bytes())
    content[content.index(bytes(50))] ^= 1  # within a message
    file.write_bytes(bytes(content))
    (bag / "metadata.yaml").write_bytes(b"")  # as a power cut may leave it
    assert tricycle("bag", "recover", bag, tmp_path / "new", "--json") == 0
    output, errors = capsys.readouterr()
    assert json.loads(output)["messages"] == 99
    assert json.loads(output)["damaged_chunks"] == 1
    assert "left out: " in errors


@pytest.mark.parametrize(
    ("arguments", "error", "reason"),
    [
        (("judge", "nowhere"), BagError, "nowhere: no such bag"),
        (("judge", "{bag}"), JudgeError, "no topic maneuver/reference"),
        (("judge", "{bag}", "--reference", "x"), JudgeError, "no topic x"),
        (("bag", "info", "nowhere"), BagError, "no such bag"),
        (("bag", "recover", "{bag}", "{bag}"), BagError, "exists: a bag is not overwritten"),
        (("record", "--output", "{bag}"), BagError, "exists: a bag is not overwritten"),
        (("replay", "nowhere"), BagError, "no such bag"),
    ],
)
def test_mistakes(
    bag: Path, arguments: tuple[str, ...], error: type[Exception], reason: str
) -> None:
    with pytest.raises(error, match=reason):
        tricycle(*(argument.format(bag=bag) for argument in arguments))


@pytest.mark.parametrize(
    "arguments",
    [
        ("judge", "bag", "--datum", "46"),
        ("judge", "bag", "--datum", "146,6"),
        ("judge", "bag", "--anchor", "elsewhere"),
        ("judge", "bag", "--export", "xml"),
        ("judge", "bag", "--plot", "figure.xls"),
        ("judge",),
        ("record", "--duration", "-3"),
        ("record", "--split-size", "big"),
        ("replay", "bag", "--rate", "nan"),
        ("replay", "bag", "--remap", "odom=x"),
    ],
)
def test_mistyped_options_are_argparses(
    arguments: tuple[str, ...], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as status:
        tricycle(*arguments)
    assert status.value.code == 2
    assert capsys.readouterr().err
