"""Definitions and hashes against the ROS installation's own."""

from pathlib import Path

import pytest
from rosbags.rosbag2.metadata import parse_qos

from trajectory_recorder.bag.metadata import dump_yaml
from trajectory_recorder.bag.topics import OfferedQos, Topic, parse_profiles
from tricycle_core.errors import BagError


def test_definition_and_hash_of_a_type_of_jazzy() -> None:
    topic = Topic.of_type("/header", "std_msgs/msg/Header")
    # as get_publishers_info_by_topic tells it
    assert topic.type_hash == (
        "RIHS01_f49fb3ae2cf070f793645ff749683ac6b06203e41c891e17701b1cb597ce6a01"
    )
    assert "MSG: builtin_interfaces/Time" in topic.definition


@pytest.mark.parametrize("text", ["wstring<=5 w\n", "string NAME=\n", "$\n", "Loop x\n", "\xff"])
def test_a_definition_that_cannot_be_read_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str
) -> None:
    folder = tmp_path / "share" / "odd_msgs" / "msg"
    folder.mkdir(parents=True)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    (folder / "Odd.msg").write_text(text, encoding="latin-1")
    (folder / "Loop.msg").write_text("Odd back\n")
    with pytest.raises(BagError, match="definition of the message type 'odd_msgs/msg/Odd'"):
        Topic.of_type("/odd", "odd_msgs/msg/Odd")


def test_types_of_installed_packages_are_found_with_their_parts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for package, name, text in (
        ("rig_msgs", "Rig", "std_msgs/Header header\nrig_msgs/Leg[] legs\nother_msgs/Part part"),
        ("rig_msgs", "Leg", "float64 length  # m"),
        ("other_msgs", "Part", "string name"),
    ):
        folder = tmp_path / "share" / package / "msg"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{name}.msg").write_text(text)
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{tmp_path}")
    topic = Topic.of_type("/rig", "rig_msgs/msg/Rig")
    for part in ("rig_msgs/Leg", "other_msgs/Part", "std_msgs/Header", "builtin_interfaces/Time"):
        assert f"MSG: {part}" in topic.definition
    assert topic.type_hash.startswith("RIHS01_")


def test_unknown_types_are_named() -> None:
    with pytest.raises(BagError, match="no definition of the message type 'no_msgs/msg/Such'"):
        Topic.of_type("/x", "no_msgs/msg/Such")


def test_a_topic_is_latched_when_all_its_publishers_are() -> None:
    latched, volatile = OfferedQos(durability="transient_local"), OfferedQos()
    assert Topic("/x", "", qos=(latched, latched)).latched
    assert not Topic("/x", "", qos=(latched, volatile)).latched
    assert not Topic("/x", "").latched


def test_profiles_are_read_as_rosbags_reads_them() -> None:
    text = dump_yaml([OfferedQos(depth=7, durability="transient_local").to_yaml()])
    numbers = text.replace("keep_last", "2").replace("reliable", "1").replace("automatic", "1")
    for profiles in (text, numbers, text.replace("reliable", "of_another_vendor"), ""):
        expected = tuple(map(OfferedQos.of_connection, parse_qos(profiles)))
        assert parse_profiles(profiles) == expected
    assert parse_profiles(text) == (OfferedQos(depth=7, durability="transient_local"),)


@pytest.mark.parametrize("text", ["- 3", "[", "{a: 1}", "- {history: 1}", "7"])
def test_profiles_that_are_none_are_left_out(text: str) -> None:
    assert parse_profiles(text) == ()
