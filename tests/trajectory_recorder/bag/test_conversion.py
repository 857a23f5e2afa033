"""Parts of bags, and bags in one."""

from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.writer import Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter

from trajectory_recorder.bag.conversion import convert
from trajectory_recorder.bag.reader import BagReader
from trajectory_recorder.bag.recovery import recover
from trajectory_recorder.bag.topics import OfferedQos, Topic, jazzy
from trajectory_recorder.bag.writer import BagWriter
from tricycle_core.errors import BagError

STRING = "std_msgs/msg/String"
S = 10**9  # ns
LATCHED = (OfferedQos(durability="transient_local"),)


def write(path: Path, stamps: range, **names: str) -> Path:
    """A latched /plan at the first stamp, and /<name> at each."""
    with BagWriter(path, metadata={path.name: "x"}) as writer:
        plan = writer.add_topic(Topic.of_type("/plan", STRING, qos=LATCHED))
        ids = [writer.add_topic(Topic.of_type(f"/{n}", kind)) for n, kind in names.items()]
        writer.write(plan, stamps[0] * S, b"plan")
        for topic in ids:
            for stamp in stamps:
                writer.write(topic, stamp * S, b"%d" % stamp)
    return path


def contents(bag: Path) -> list[tuple[str, int]]:
    with BagReader(bag) as reader:
        return [(message.topic, message.stamp // S) for message in reader.messages()]


def test_a_part_has_the_latched_messages_of_before(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", range(100, 110), odom=STRING, imu=STRING)
    count = convert([bag], tmp_path / "part", topics=["/plan", "/odom"], start=5, duration=2)
    expected = [("/plan", 105), ("/odom", 105), ("/odom", 106), ("/odom", 107)]
    assert contents(tmp_path / "part") == expected
    assert count == len(expected)


@pytest.mark.parametrize(
    ("kind", "depths", "kept"),
    [
        (STRING, (1,), "3"),
        (STRING, (2,), "23"),
        (STRING, (1, 1), "23"),
        ("tf2_msgs/msg/TFMessage", (1,), "123"),
    ],
)
def test_of_earlier_latched_messages_a_part_has_those_of_a_late_subscriber(
    tmp_path: Path, kind: str, depths: tuple[int, ...], kept: str
) -> None:
    qos = tuple(OfferedQos(durability="transient_local", depth=depth) for depth in depths)
    with BagWriter(tmp_path / "bag") as writer:
        plan = writer.add_topic(Topic.of_type("/plan", kind, qos=qos))
        odom = writer.add_topic(Topic.of_type("/odom", STRING))
        for stamp in range(1, 5):
            writer.write(plan, stamp * S, b"%d" % stamp)
            writer.write(odom, stamp * S, b"")
    assert convert([tmp_path / "bag"], tmp_path / "part", start=2.5) == len(kept) + 2
    with BagReader(tmp_path / "part") as reader:
        plans = [(m.stamp, m.data.decode()) for m in reader.messages({"/plan"})]
    begin = round(3.5 * S)
    assert plans == [*((begin, number) for number in kept), (4 * S, "4")]


def test_several_bags_become_one_by_their_stamps(tmp_path: Path) -> None:
    first = write(tmp_path / "first", range(0, 6, 2), odom=STRING)
    second = write(tmp_path / "second", range(1, 6, 2), odom=STRING)
    assert convert([first, second], tmp_path / "both") == 8
    assert [t for _, t in contents(tmp_path / "both")] == [0, 0, 1, 1, 2, 3, 4, 5]
    with BagReader(tmp_path / "both") as reader:
        assert reader.metadata == {"first": "x", "second": "x"}
        assert reader.topics["/odom"].count == 6
        assert reader.span == (0, 5 * S)


def test_the_duration_counts_to_the_ns(tmp_path: Path) -> None:
    first = 1_700_000_000_000_000_100
    with BagWriter(tmp_path / "bag") as writer:
        odom = writer.add_topic(Topic.of_type("/odom", STRING))
        for stamp in (first, first + S, first + S + 1):
            writer.write(odom, stamp, b"")
    assert convert([tmp_path / "bag"], tmp_path / "part", duration=1.0) == 2


def test_bags_with_different_versions_of_a_type_are_not_joined(tmp_path: Path) -> None:
    """Messages of one of them could not be read by the definition of the other."""
    for number in range(2):
        with BagWriter(tmp_path / f"{number}") as writer:
            topic = Topic("/odom", "own/msg/Odom", f"int{8 << number} a", f"RIHS01_{number}")
            writer.write(writer.add_topic(topic), 0, b"")
    with pytest.raises(BagError, match="/odom has two definitions of its type own/msg/Odom"):
        convert([tmp_path / "0", tmp_path / "1"], tmp_path / "both")
    assert not (tmp_path / "both").exists()


@pytest.mark.parametrize("how", ["convert", "recover"])
def test_times_of_publication_are_kept(tmp_path: Path, how: str) -> None:
    """As rosbag2 writes them, also from the simulation's clock; not known, they are the stamps."""
    bag = tmp_path / "bag.mcap"
    with bag.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(STRING, "ros2msg", b"string data")
        channel = writer.register_channel("/odom", "cdr", schema)
        writer.add_message(channel, 5 * S, b"sent", publish_time=4 * S)
        writer.add_message(channel, 6 * S, b"unknown", publish_time=6 * S)
        writer.finish()
    if how == "convert":
        convert([bag], tmp_path / "new")
    else:
        recover(bag, tmp_path / "new")
    with (tmp_path / "new" / "new_0.mcap").open("rb") as file:
        times = [(m.log_time, m.publish_time) for _, _, m in make_reader(file).iter_messages()]
    assert times == [(5 * S, 4 * S), (6 * S, 6 * S)]
    with BagReader(tmp_path / "new") as reader:
        assert [message.published for message in reader.messages()] == [4 * S, None]


@pytest.mark.parametrize("again", ["first", "./first", "link", "first/first_0.mcap"])
def test_a_bag_given_twice_is_refused(
    tmp_path: Path, again: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write(Path("first"), range(3), odom=STRING)
    write(Path("second"), range(3), odom=STRING)
    Path("link").symlink_to("first")
    with pytest.raises(BagError, match=rf"^{Path(again)}: is given twice"):
        convert([Path("first"), Path("second"), Path(again)], tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_no_bag_is_written_into_one_that_is_read(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", range(3), odom=STRING)
    before = sorted(bag.iterdir())
    for writes in (lambda given, output: convert([given], output), recover):
        for given in (bag, bag / "bag_0.mcap"):
            with pytest.raises(BagError, match=r"inside: is within the bag .*bag; name a folder"):
                writes(given, bag / "inside")
    assert sorted(bag.iterdir()) == before


def test_messages_and_definitions_keep_their_encodings(tmp_path: Path) -> None:
    with (tmp_path / "foreign.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        for encoding, kind, definition in (
            ("json", "jsonschema", b'{"type": "object"}'),
            ("protobuf", "protobuf", b"\x0a\xff\xfe"),
            ("cdr", "ros2idl", b"module std_msgs {};"),
        ):
            schema = writer.register_schema("foxglove.Pose", kind, definition)
            channel = writer.register_channel(f"/{encoding}", encoding, schema)
            writer.add_message(channel, 10, b"{}", 10)
        writer.finish()
    convert([tmp_path / "foreign.mcap"], tmp_path / "new")
    recover(tmp_path / "foreign.mcap", tmp_path / "recovered")
    for name in ("new", "recovered"):
        with (tmp_path / name / f"{name}_0.mcap").open("rb") as stream:
            found = {
                (channel.topic, channel.message_encoding, schema.encoding, schema.data)
                for schema, channel, _ in make_reader(stream).iter_messages()
                if schema is not None
            }
        assert found == {
            ("/json", "json", "jsonschema", b'{"type": "object"}'),
            ("/protobuf", "protobuf", "protobuf", b"\x0a\xff\xfe"),
            ("/cdr", "cdr", "ros2idl", b"module std_msgs {};"),
        }


def test_metadata_that_differ_are_left_out(tmp_path: Path) -> None:
    for name, plan in (("a", "1"), ("b", "2")):
        with BagWriter(tmp_path / name, metadata={"plan_id": plan, "vehicle": "v"}) as writer:
            writer.write(writer.add_topic(Topic.of_type("/odom", STRING)), 1, b"")
    convert([tmp_path / "a", tmp_path / "b"], tmp_path / "both")
    with BagReader(tmp_path / "both") as reader:
        assert reader.metadata == {"vehicle": "v"}


@pytest.mark.parametrize("lost", [("1 of /odom", "2 of /odom"), ("1 of /odom",), ()])
def test_what_comes_of_a_bag_that_is_not_whole_is_not_whole(
    tmp_path: Path, lost: tuple[str, ...]
) -> None:
    bags = [write(tmp_path / "torn", range(3), odom=STRING)]
    (file,) = bags[0].glob("*.mcap")
    file.write_bytes(file.read_bytes()[: -20 if not lost else None])
    for text in lost:
        bags.append(tmp_path / text[0])
        with BagWriter(bags[-1], metadata={"lost": text}) as writer:
            writer.write(writer.add_topic(Topic.of_type("/odom", STRING)), 1, b"")
    convert(bags, tmp_path / "new")
    with BagReader(tmp_path / "new") as reader:
        assert not reader.complete


def test_a_topic_with_two_encodings_is_refused(tmp_path: Path) -> None:
    for name, encoding in (("a", "cdr"), ("b", "json")):
        with BagWriter(tmp_path / name) as writer:
            writer.write(writer.add_topic(Topic("/x", STRING, encoding=encoding)), 1, b"{}")
    with pytest.raises(BagError, match="/x has two encodings, cdr and json"):
        convert([tmp_path / "a", tmp_path / "b"], tmp_path / "both")


def test_what_cannot_be_written_leaves_no_bag(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", range(3), odom=STRING)
    other = write(tmp_path / "other", range(3), odom="std_msgs/msg/Bool")
    for bags, options, reason in (
        ([bag], {"topics": ["/nothing"]}, "no message is left"),
        ([bag], {"start": 9.0}, "shorter than 9 s"),
        ([bag], {"start": 1.2, "duration": 0.5, "topics": ["/odom"]}, "none of the topics has one"),
        ([bag, other], {}, "two types"),
        ([tmp_path / "nowhere"], {}, "no such bag"),
    ):
        with pytest.raises(BagError, match=reason):
            convert(bags, tmp_path / "new", **options)  # type: ignore[arg-type]
        assert not (tmp_path / "new").exists()


def test_a_conversion_that_breaks_off_leaves_no_bag(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", range(30_000), odom=STRING)
    file = bag / "bag_0.mcap"
    content = bytearray(file.read_bytes())
    content[len(content) // 3] ^= 0xFF
    file.write_bytes(content)
    with pytest.raises(BagError, match="damaged at byte"):
        convert([bag], tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_a_split_by_duration_does_not_wait_for_a_full_chunk(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", range(20), odom=STRING)
    convert([bag], tmp_path / "new", split_duration=5.0)
    with BagReader(tmp_path / "new") as reader:
        assert [file.name for file in reader.files] == [f"new_{i}.mcap" for i in range(4)]


def test_a_stamp_before_1970_is_told(tmp_path: Path) -> None:
    with RosbagsWriter(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        topic = writer.add_connection("/odom", STRING, typestore=jazzy())
        writer.write(topic, -1, b"early")
    with pytest.raises(BagError, match="no bag holds the stamp -1 ns"):
        convert([tmp_path / "bag"], tmp_path / "new")
    assert not (tmp_path / "new").exists()
