"""What a recording is made of: latched messages, losses, the disk, its state."""

import os
from pathlib import Path

import pytest

from trajectory_recorder.bag.reader import BagReader
from trajectory_recorder.bag.topics import OfferedQos, Topic, jazzy
from trajectory_recorder.recording import BagSettings, Recording
from trajectory_recorder.topic_patterns import chosen, matches
from trajectory_recorder.topic_source import TopicSource
from tricycle_core.diagnostics import Level
from tricycle_core.errors import BagError

TYPE = "std_msgs/msg/String"
LATCHED = (OfferedQos(durability="transient_local", depth=1),)
ONE = (OfferedQos(),)
PATTERNS = ["/odom", "/maneuver/*"]


@pytest.fixture
def failures() -> list[str]:
    return []


@pytest.fixture
def recording(failures: list[str]) -> Recording:
    return Recording(BagSettings(metadata={"software_version": "1"}), failures.append)


def topic(name: str, qos: tuple[OfferedQos, ...] = ONE, type_name: str = TYPE) -> Topic:
    return Topic.of_type(name, type_name, qos=qos)


def contents(bag: Path) -> list[tuple[str, int, bytes]]:
    with BagReader(bag) as reader:
        return [message[:3] for message in reader.messages()]


def test_a_bag_begins_with_the_latched_messages_of_before(
    recording: Recording, tmp_path: Path
) -> None:
    plan = recording.offer(topic("/maneuver/path", LATCHED))
    odom = recording.offer(topic("/odom"))
    for source, data in ((plan, b"old"), (plan, b"new"), (odom, b"before")):
        source.received(data, 1)
        recording.write(source, data, 5)
    bag = recording.start(str(tmp_path / "bag"), 10)
    recording.write(odom, b"during", 11)
    assert recording.stop() == bag == tmp_path / "bag"
    recording.write(odom, b"after", 12)
    assert contents(bag) == [("/maneuver/path", 10, b"new"), ("/odom", 11, b"during")]


def test_without_a_time_a_bag_begins_with_the_first_one(
    recording: Recording, tmp_path: Path
) -> None:
    plan = recording.offer(topic("/maneuver/path", LATCHED))
    plan.received(b"plan", 1)
    bag = recording.start(str(tmp_path / "bag"), None)
    recording.write_latched(7)
    recording.stop()
    assert contents(bag) == [("/maneuver/path", 7, b"plan")]


def test_a_topic_that_comes_late_is_recorded(recording: Recording, tmp_path: Path) -> None:
    bag = recording.start(str(tmp_path / "bag"), 0)
    recording.write(recording.offer(topic("/late")), b"x", 1)
    recording.stop()
    assert contents(bag) == [("/late", 1, b"x")]


def test_lost_messages_are_counted_per_publisher(recording: Recording) -> None:
    source = recording.offer(topic("/odom"))
    for sequence in (1, 2, 5, 6):
        source.received(b"", sequence)
    assert source.lost == 2
    assert recording.offer(topic("/odom")) is source  # a publisher begins again
    source.received(b"", 1)
    recording.offer(topic("/odom", ONE * 2))  # two publishers number on their own
    for sequence in (1, 9):
        source.received(b"", sequence)
    assert source.lost == 2
    assert recording.status(PATTERNS).message == "2 messages lost"
    assert recording.status(PATTERNS).level is Level.WARN


def test_a_bag_says_which_messages_it_lacks(recording: Recording, tmp_path: Path) -> None:
    odom = recording.offer(topic("/odom"))
    bag = recording.start(str(tmp_path / "bag"), 0)
    for sequence in (1, 4):
        odom.received(b"", sequence)
        recording.write(odom, b"x", sequence)
    assert recording.lost == "2 of /odom"
    recording.stop()
    with BagReader(bag) as reader:
        assert reader.metadata["lost"] == "2 of /odom"
        assert not reader.complete


def test_also_the_bag_of_a_killed_recorder_says_which_messages_it_lacks(
    recording: Recording, tmp_path: Path
) -> None:
    odom = recording.offer(topic("/odom"))
    bag = recording.start(str(tmp_path / "bag"), 0)
    for sequence in (1, 4):
        odom.received(b"", sequence)
        recording.write(odom, b"x", sequence)
    recording.flush()
    with BagReader(bag) as reader:
        assert reader.metadata["lost"] == "2 of /odom"


def test_a_superseded_state_is_not_lost(recording: Recording) -> None:
    state = recording.offer(topic("/maneuver/state", LATCHED))
    for sequence in (1, 4):
        state.received(b"", sequence)
    assert not recording.lost


def test_values_of_diagnostics_become_metadata(recording: Recording, tmp_path: Path) -> None:
    kind = "diagnostic_msgs/msg/DiagnosticStatus"
    types = jazzy().types
    pairs = {"plan_id": "p1", "vehicle_hash": "abc", "elapsed": "1.0"}
    message = types[kind](
        level=0, name="", message="", hardware_id="",
        values=[types["diagnostic_msgs/msg/KeyValue"](key=k, value=v) for k, v in pairs.items()],
    )  # fmt: skip
    state = recording.offer(topic("/maneuver/state", type_name=kind))
    bag = recording.start(str(tmp_path / "bag"), 0)
    recording.write(state, bytes(jazzy().serialize_cdr(message, kind)), 1)
    recording.write(state, b"no such message", 2)
    recording.stop()
    with BagReader(bag) as reader:
        assert reader.metadata == {
            "software_version": "1", "plan_id": "p1", "vehicle_hash": "abc",
        }  # fmt: skip
        assert reader.topics["/maneuver/state"].count == 2


def test_the_state_names_what_is_missing_and_refused(recording: Recording, tmp_path: Path) -> None:
    status = recording.status(PATTERNS)
    assert (status.level, status.message) == (Level.OK, "not recording")
    assert status.values["missing"] == "/odom /maneuver/*"
    recording.offer(topic("/odom"))
    recording.start(str(tmp_path / "bag"), 0)
    status = recording.status(PATTERNS)
    assert (status.level, status.message) == (Level.OK, "recording")
    assert (status.values["topics"], status.values["missing"]) == ("/odom", "/maneuver/*")
    assert status.values["messages"] == 0
    recording.refused["/tf"] = "of no known type"
    status = recording.status(PATTERNS)
    assert (status.level, status.values["/tf"]) == (Level.WARN, "of no known type")
    recording.stop()


def test_mistakes_are_named(recording: Recording, tmp_path: Path) -> None:
    with pytest.raises(BagError, match="not recording"):
        recording.stop()
    with pytest.raises(BagError, match="output is empty"):
        recording.start("", 0)
    recording.start(str(tmp_path / "bag"), 0)
    with pytest.raises(BagError, match="already recording"):
        recording.start(str(tmp_path / "other"), 0)
    recording.stop()
    with pytest.raises(BagError, match="exists"):
        recording.start(str(tmp_path / "bag"), 0)


def test_a_disk_without_reserve_is_told_before_a_bag_is_begun(
    failures: list[str], tmp_path: Path
) -> None:
    recording = Recording(BagSettings(disk_reserve=1e18), failures.append)
    with pytest.raises(BagError, match="MB of disk left, disk_reserve is 1000000000000 MB"):
        recording.check_room(str(tmp_path / "deep" / "bag"))
    assert not (tmp_path / "deep").exists()
    for there in (tmp_path / "bag", tmp_path, "/"):
        Recording(BagSettings(disk_reserve=1.0), failures.append).check_room(str(there))


def test_a_disk_without_reserve_ends_the_recording(failures: list[str], tmp_path: Path) -> None:
    recording = Recording(BagSettings(disk_reserve=1e18), failures.append)
    source = recording.offer(topic("/odom"))
    bag = recording.start(str(tmp_path / "bag"), 0)
    recording.write(source, b"x", 1)
    recording.flush()
    (failure,) = failures
    assert "MB of disk left, disk_reserve is 1000000000000 MB" in failure
    assert recording.status([]).level is Level.ERROR
    with pytest.raises(BagError, match="disk left"):
        recording.stop()
    recording.flush()
    assert contents(bag) == [("/odom", 1, b"x")]
    with BagReader(bag) as reader:
        assert "disk_reserve" in reader.metadata["failure"]
        assert not reader.complete


def test_patterns() -> None:
    assert matches("/maneuver/path", PATTERNS)
    assert not matches("/odometry", PATTERNS)


def test_a_topic_of_another_type_is_another_topic(tmp_path: Path) -> None:
    recording = Recording(BagSettings(backlog=1000), [].append)
    recording.write(recording.offer(topic("/odom")), b"of the old type", 1)
    recording.write(recording.offer(topic("/imu")), b"kept", 2)
    other = topic("/odom", type_name="std_msgs/msg/Bool")
    assert not recording.forget_other_type(topic("/odom"))
    assert recording.forget_other_type(other)
    recording.offer(other)
    assert contents(recording.snapshot(str(tmp_path / "bag"))) == [("/imu", 2, b"kept")]
    recording.start(str(tmp_path / "next"), 3)
    with pytest.raises(BagError, match="has the type std_msgs/msg/String, and std_msgs/msg/Bool"):
        recording.forget_other_type(topic("/odom"))


@pytest.mark.parametrize("pattern", ["odmo", "/odmo"])
def test_a_misspelt_topic_of_a_bag_is_told(pattern: str) -> None:
    with pytest.raises(BagError, match=r"no topic of the bag is /odmo; did you mean /odom\?"):
        chosen(["/odom", "/imu"], ["imu", pattern], [])
    with pytest.raises(BagError, match=r"no topic of the bag is /odmo; did you mean /odom\?"):
        chosen(["/odom", "/imu"], ["*"], ["imu", pattern])


def test_a_snapshot_holds_the_newest_messages_and_what_was_latched(tmp_path: Path) -> None:
    recording = Recording(BagSettings(backlog=4), lambda _: None)
    plan = recording.offer(topic("/maneuver/path", LATCHED))
    odom = recording.offer(topic("/odom"))
    for source, data, stamp in [(plan, b"p", 0), *((odom, b"%d" % i, i) for i in range(1, 9))]:
        source.received(data, 1)
        recording.write(source, data, stamp)
    expected = [("/maneuver/path", 5, b"p"), *(("/odom", i, b"%d" % i) for i in range(5, 9))]
    assert contents(recording.snapshot(str(tmp_path / "first"))) == expected
    recording.write(odom, b"9", 9)
    assert contents(recording.snapshot(str(tmp_path / "second"))) == [
        ("/maneuver/path", 9, b"p"), ("/odom", 9, b"9"),
    ]  # fmt: skip


def test_a_snapshot_holds_what_was_latched_while_a_bag_was_recorded(tmp_path: Path) -> None:
    recording = Recording(BagSettings(backlog=100), lambda _: None)
    plan, odom = recording.offer(topic("/maneuver/path", LATCHED)), recording.offer(topic("/odom"))

    def take(source: TopicSource, data: bytes, stamp: int) -> None:
        source.received(data, stamp)
        recording.write(source, data, stamp)

    take(plan, b"A", 1)
    recording.start(str(tmp_path / "bag"), 2)
    take(plan, b"B", 3)
    recording.stop()
    take(odom, b"x", 5)
    assert contents(recording.snapshot(str(tmp_path / "snapshot"))) == [
        ("/maneuver/path", 5, b"B"), ("/odom", 5, b"x"),
    ]  # fmt: skip


def test_a_snapshot_says_which_messages_it_lacks(tmp_path: Path) -> None:
    recording = Recording(BagSettings(backlog=100), lambda _: None)
    odom = recording.offer(topic("/odom"))
    for sequence in (1, 4):
        odom.received(b"", sequence)
        recording.write(odom, b"x", sequence)
    with BagReader(recording.snapshot(str(tmp_path / "first"))) as reader:
        assert reader.metadata["lost"] == "2 of /odom"
    odom.received(b"", 5)
    recording.write(odom, b"x", 5)
    with BagReader(recording.snapshot(str(tmp_path / "second"))) as reader:
        assert "lost" not in reader.metadata  # what was lost before is not missing here


def test_a_snapshot_needs_messages_that_are_kept(recording: Recording, tmp_path: Path) -> None:
    with pytest.raises(BagError, match="snapshot_size"):
        recording.snapshot(str(tmp_path / "bag"))
    with pytest.raises(BagError, match="no message was received"):
        Recording(BagSettings(backlog=9), lambda _: None).snapshot(str(tmp_path / "bag"))
    assert not (tmp_path / "bag").exists()


def test_a_pause_leaves_out_all_but_latched_messages(recording: Recording, tmp_path: Path) -> None:
    plan = recording.offer(topic("/maneuver/path", LATCHED))
    odom = recording.offer(topic("/odom"))
    bag = recording.start(str(tmp_path / "bag"), 0)
    recording.write(odom, b"before", 1)
    recording.pause()
    state = recording.status([])
    assert (state.level, state.message) == (Level.WARN, "paused")
    assert "paused" in state.values  # by which a drive that is to be recorded is refused
    recording.write(odom, b"between", 2)
    recording.write(plan, b"plan", 3)
    recording.resume()
    recording.write(odom, b"after", 4)
    recording.stop()
    assert contents(bag) == [
        *(("/odom", 1, b"before"), ("/maneuver/path", 3, b"plan"), ("/odom", 4, b"after")),
    ]
    with pytest.raises(BagError, match="not recording"):
        recording.pause()


def test_a_split_begins_a_file_that_can_be_used_alone(recording: Recording, tmp_path: Path) -> None:
    plan = recording.offer(topic("/maneuver/path", LATCHED))
    odom = recording.offer(topic("/odom"))
    bag = recording.start(str(tmp_path / "bag"), 0)
    recording.write(plan, b"plan", 1)
    recording.split(2)
    recording.split(2)
    recording.write(odom, b"x", 3)
    recording.stop()
    first, second, third = sorted(bag.glob("*.mcap"))
    assert contents(first) == [("/maneuver/path", 1, b"plan")]
    assert contents(second) == [("/maneuver/path", 2, b"plan")]
    assert contents(third) == [("/maneuver/path", 2, b"plan"), ("/odom", 3, b"x")]


def test_a_split_repeats_the_messages_of_publishers_that_came_later(
    recording: Recording, tmp_path: Path
) -> None:
    recording.offer(topic("/tf_static", LATCHED))
    bag = recording.start(str(tmp_path / "bag"), 0)
    static = recording.offer(topic("/tf_static", LATCHED * 3))
    for data in (b"A", b"B", b"C"):
        recording.write(static, data, 1)
    recording.split(2)
    recording.stop()
    second = bag / "bag_1.mcap"
    assert contents(second) == [("/tf_static", 2, data) for data in (b"A", b"B", b"C")]
    with BagReader(second) as reader:
        assert len(reader.topics["/tf_static"].qos) == 3


@pytest.mark.parametrize("harm", ["deleted", "cut"])
def test_a_bag_that_is_deleted_or_cut_ends_the_recording(
    recording: Recording, failures: list[str], tmp_path: Path, harm: str
) -> None:
    source = recording.offer(topic("/odom"))
    bag = recording.start(str(tmp_path / "bag"), 0)
    recording.write(source, b"x", 1)
    recording.flush()
    (file,) = bag.glob("*.mcap")
    if harm == "deleted":
        file.unlink()
    else:
        os.truncate(file, 50)
    recording.flush()
    (failure,) = failures
    assert ("was deleted" if harm == "deleted" else "has 50 bytes instead of") in failure
    assert recording.status([]).level is Level.ERROR
