"""Foreign bags, torn bags, and what is no bag."""

import resource
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import zstandard
from hypothesis import given
from hypothesis import strategies as st
from mcap.records import Chunk, Statistics
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.rosbag2.enums import CompressionFormat, CompressionMode

from trajectory_recorder.bag.mcap_file import _uncompress
from trajectory_recorder.bag.reader import BagReader, RecordedMessage
from trajectory_recorder.bag.records import serialize
from trajectory_recorder.bag.recovery import recover
from trajectory_recorder.bag.topics import Topic, deserialize, jazzy
from trajectory_recorder.bag.writer import BagWriter, Compression
from tricycle_core.errors import BagError

STRING = "std_msgs/msg/String"
DEFINITION = b"string data"
MESSAGES = [RecordedMessage(f"/chatter{i % 3}", i, bytes([i % 256]) * (i % 50)) for i in range(300)]


def write_own(path: Path, compression: Compression = Compression.ZSTD) -> Path:
    with BagWriter(path, compression=compression, chunk_size=500) as bag:
        ids = [bag.add_topic(Topic.of_type(f"/chatter{i}", STRING)) for i in range(3)]
        for i, message in enumerate(MESSAGES):
            bag.write(ids[i % 3], message.stamp, message.data)
    return path


def write_with_rosbags(path: Path, plugin: StoragePlugin, mode: CompressionMode) -> None:
    writer = RosbagsWriter(path, version=9, storage_plugin=plugin)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        connections = [
            writer.add_connection(f"/chatter{i}", STRING, typestore=jazzy()) for i in range(3)
        ]
        for i, message in enumerate(MESSAGES):
            writer.write(connections[i % 3], message.stamp, message.data)


@pytest.mark.parametrize(
    ("plugin", "mode"),
    [
        (plugin, mode)
        for plugin in StoragePlugin
        for mode in CompressionMode
        # compression by the storage plugin exists for MCAP only
        if (plugin, mode) != (StoragePlugin.SQLITE3, CompressionMode.STORAGE)
    ],
)
def test_bags_of_rosbags_are_read(
    tmp_path: Path, plugin: StoragePlugin, mode: CompressionMode
) -> None:
    write_with_rosbags(tmp_path / "bag", plugin, mode)
    (file,) = (file for file in (tmp_path / "bag").iterdir() if file.name != "metadata.yaml")
    with BagReader(tmp_path / "bag") as reader:
        assert reader.kind == plugin.name.lower()
        assert reader.files == [file]
        assert reader.size == file.stat().st_size
        assert list(reader.messages()) == MESSAGES
        assert list(reader.messages({"/chatter1"})) == MESSAGES[1::3]
        assert list(reader.messages({"/nothing"})) == []
        assert reader.topics["/chatter2"].count == 100
        assert reader.topics["/chatter2"].type == STRING
        assert reader.span == (0, 299)


def test_a_database_without_metadata_is_named(tmp_path: Path) -> None:
    """As rosbag2 leaves it when it is killed."""
    write_with_rosbags(tmp_path / "bag", StoragePlugin.SQLITE3, CompressionMode.NONE)
    (tmp_path / "bag" / "metadata.yaml").unlink()
    with pytest.raises(BagError, match=r"is not a bag: .*; give the database itself, \S*\.db3$"):
        BagReader(tmp_path / "bag")
    (database,) = (tmp_path / "bag").glob("*.db3")
    with BagReader(database) as reader:
        assert len(list(reader.messages())) == len(MESSAGES)


@pytest.mark.parametrize("kind", ["split", "torn", "unchunked", "sqlite3"])
def test_messages_by_stamp(tmp_path: Path, kind: str) -> None:
    """However they were written: here the topics of each second one after the other."""
    written = sorted(MESSAGES, key=lambda m: (m.stamp // 30, m.topic))
    bag = tmp_path / "bag"
    if kind == "unchunked":
        bag = tmp_path / "bag.mcap"
        with bag.open("wb") as file:
            writer = Writer(file, use_chunking=False)
            writer.start()
            schema = writer.register_schema(STRING, "ros2msg", DEFINITION)
            channels = {
                f"/chatter{i}": writer.register_channel(f"/chatter{i}", "cdr", schema)
                for i in range(3)
            }
            for m in written:
                writer.add_message(channels[m.topic], m.stamp, m.data, m.stamp)
            writer.finish()
    elif kind == "sqlite3":
        write_with_rosbags(bag, StoragePlugin.SQLITE3, CompressionMode.NONE)
    else:
        size = 1500 if kind == "split" else 0
        with BagWriter(bag, chunk_size=500, split_size=size) as writer:
            ids = {
                f"/chatter{i}": writer.add_topic(Topic.of_type(f"/chatter{i}", STRING))
                for i in range(3)
            }
            for m in written:
                writer.write(ids[m.topic], m.stamp, m.data)
    if kind == "torn":
        (file,) = bag.glob("*.mcap")
        file.write_bytes(file.read_bytes()[:-100])
    with BagReader(bag) as reader:
        assert reader.complete == (kind != "torn")
        assert list(reader.messages_by_stamp()) == MESSAGES
        assert list(reader.messages_by_stamp(["/chatter1"])) == MESSAGES[1::3]


def test_a_missing_file_of_a_split_bag_is_noticed(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", chunk_size=500, split_size=1500) as writer:
        chatter = writer.add_topic(Topic.of_type("/chatter0", STRING))
        for m in MESSAGES:
            writer.write(chatter, m.stamp, m.data)
    with BagReader(tmp_path / "bag") as reader:
        assert reader.complete
        assert len(reader.files) > 2
    reader.files[1].unlink()
    with BagReader(tmp_path / "bag") as reader:
        assert not reader.complete


def test_a_file_whose_end_was_being_replaced_is_not_whole(tmp_path: Path) -> None:
    """The machine stopped while a longer file was written over the end of the one before."""
    with BagWriter(tmp_path / "bag", chunk_size=500) as writer:
        chatter = writer.add_topic(Topic.of_type("/chatter0", STRING))
        for m in MESSAGES[:100]:
            writer.write(chatter, m.stamp, m.data)
        writer.flush()
        (file,) = (tmp_path / "bag").glob("*.mcap")
        before = file.read_bytes()
        for m in MESSAGES[100:]:
            writer.write(chatter, m.stamp, m.data)
    after = file.read_bytes()
    same = next(i for i, (a, b) in enumerate(zip(before, after, strict=False)) if a != b)
    for torn in range(same + 20, len(before), 50):  # within the old summary
        file.write_bytes(after[:torn] + before[torn:])
        with BagReader(file) as reader:
            assert not reader.complete
            assert len(list(reader.messages())) >= 100


def write_by_mcap(path: Path, **options: Any) -> None:
    """Write the messages by turns to three topics with the writer of the package `mcap`."""
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=700, **options)
        writer.start(profile="ros2")
        schema = writer.register_schema(STRING, "ros2msg", DEFINITION)
        ids = [writer.register_channel(f"/chatter{i}", "cdr", schema) for i in range(3)]
        for i, message in enumerate(MESSAGES):
            writer.add_message(ids[i % 3], message.stamp, message.data, message.stamp)
        writer.finish()


@pytest.mark.parametrize("compression", CompressionType)
@pytest.mark.parametrize("index", [IndexType.ALL, IndexType.NONE, ~IndexType.MESSAGE])
@pytest.mark.parametrize("chunks", [True, False])
def test_files_of_mcaps_own_writer_are_read(
    tmp_path: Path, compression: CompressionType, index: IndexType, chunks: bool
) -> None:
    path = tmp_path / "foreign.mcap"
    write_by_mcap(path, compression=compression, index_types=index, use_chunking=chunks)
    with BagReader(path) as reader:
        assert reader.complete
        assert list(reader.messages()) == MESSAGES
        assert list(reader.messages({"/chatter1"})) == MESSAGES[1::3]
        assert {name: topic.count for name, topic in reader.topics.items()} == {
            "/chatter0": 100, "/chatter1": 100, "/chatter2": 100,
        }  # fmt: skip


@pytest.mark.parametrize("missing", ["repeat_channels", "repeat_schemas", "use_statistics"])
def test_a_summary_need_not_repeat_channels_and_schemas(tmp_path: Path, missing: str) -> None:
    path = tmp_path / "foreign.mcap"
    write_by_mcap(path, **{missing: False})
    with BagReader(path) as reader:
        assert reader.complete
        assert list(reader.messages()) == MESSAGES
        assert {topic.type for topic in reader.topics.values()} == {STRING}
        assert reader.topics["/chatter1"].count == 100


def test_a_summary_need_not_count_by_channel(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An empty map means "not available" in MCAP's specification."""
    write = Statistics.write
    monkeypatch.setattr(
        Statistics, "write", lambda self, to: write(replace(self, channel_message_counts={}), to)
    )
    write_by_mcap(tmp_path / "foreign.mcap")
    with BagReader(tmp_path / "foreign.mcap") as reader:
        assert reader.complete
        assert list(reader.messages()) == MESSAGES
        assert reader.topics["/chatter1"].count == 100


@pytest.mark.parametrize("index", [IndexType.ALL, ~IndexType.MESSAGE])
def test_messages_beside_chunks_are_read(tmp_path: Path, index: IndexType) -> None:
    path = tmp_path / "foreign.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, index_types=index)
        writer.start()
        schema = writer.register_schema(STRING, "ros2msg", DEFINITION)
        channel = writer.register_channel("/chatter0", "cdr", schema)
        for stamp in range(10):
            if stamp == 5:
                writer._Writer__finalize_chunk()  # type: ignore[attr-defined]
                writer._Writer__chunk_builder = None  # type: ignore[attr-defined]
            writer.add_message(channel, stamp, b"", stamp)
        writer.finish()
    with BagReader(path) as reader:
        assert reader.complete
        assert [message.stamp for message in reader.messages()] == list(range(10))
        assert reader.topics["/chatter0"].count == 10


def test_a_message_index_that_lost_entries_is_told(tmp_path: Path) -> None:
    path = write_own(tmp_path / "bag") / "bag_0.mcap"
    with BagReader(path) as reader:
        index = reader._storages[0]._chunks[5].indexes[1]  # type: ignore[attr-defined]
    content = bytearray(path.read_bytes())
    content[index + 1] -= 16  # of its length: an entry less
    path.write_bytes(content)
    with BagReader(path) as reader, pytest.raises(BagError, match="its message index is wrong"):
        list(reader.messages())


def test_a_chunk_that_is_larger_than_it_says_is_not_decompressed() -> None:
    data = zstandard.ZstdCompressor().compress(bytes(1_000_000))
    chunk = Chunk("zstd", data, 1, 0, 0, uncompressed_size=1000)
    with pytest.raises(ValueError, match="zstd frame has another size"):
        _uncompress(serialize(chunk))


@pytest.mark.slow
@given(data=st.data(), compression=st.sampled_from(Compression))
def test_a_bag_torn_at_any_byte_is_read_up_to_there(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject, compression: Compression
) -> None:
    path = write_own(tmp_path_factory.mktemp("torn") / "bag", compression) / "bag_0.mcap"
    whole = path.read_bytes()
    size = data.draw(st.integers(0, len(whole) - 1))
    path.write_bytes(whole[:size])
    try:
        with BagReader(path) as reader:
            found = list(reader.messages())
            assert not reader.complete
    except BagError as error:
        assert size < 1000, error  # noqa: PT017 - no topic before the tear
        found = []
    assert found == MESSAGES[: len(found)]
    # what is missing is no more than a chunk, when the tear is in the data
    if size > 0.9 * len(whole):
        assert found


@pytest.mark.slow
@given(data=st.data())
def test_damage_is_told_or_harmless(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    """A flipped byte never yields messages that were not recorded, nor loses some silently."""
    path = write_own(tmp_path_factory.mktemp("damaged") / "bag", Compression.NONE) / "bag_0.mcap"
    content = bytearray(path.read_bytes())
    start = content.index(b"string data") + 20  # behind the first schema
    position = data.draw(st.integers(start, len(content) - 1))
    content[position] ^= data.draw(st.integers(1, 255))
    path.write_bytes(content)
    try:
        with BagReader(path) as reader:
            found = list(reader.messages())
            whole = reader.complete
    except BagError:
        return
    known = {(m.stamp, m.data) for m in MESSAGES}
    assert {(m.stamp, m.data) for m in found} <= known
    assert len(found) == len(MESSAGES) or not whole


def test_a_bag_without_metadata_yaml_is_read(tmp_path: Path) -> None:
    write_own(tmp_path / "bag")
    (tmp_path / "bag" / "metadata.yaml").unlink()
    with BagReader(tmp_path / "bag") as reader:
        assert list(reader.messages()) == MESSAGES


def test_a_torn_bag_still_says_what_was_driven(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", metadata={"plan_id": "abc"}) as bag:
        bag.write(bag.add_topic(Topic.of_type("/chatter", STRING)), 1, bytes(8))
    (file,) = (tmp_path / "bag").glob("*.mcap")
    file.write_bytes(file.read_bytes().partition(b"plan_id")[0])
    with BagReader(file) as reader:
        assert not reader.metadata
    recover(tmp_path / "bag", tmp_path / "whole")
    for path in (tmp_path / "bag", tmp_path / "whole"):
        with BagReader(path) as reader:
            assert reader.metadata["plan_id"] == "abc", path


def test_parts_are_read_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", split_size=200, chunk_size=100) as bag:
        topic = bag.add_topic(Topic.of_type("/chatter", STRING))
        for stamp in range(60):
            bag.write(topic, stamp, b"x" * 20)
    assert (tmp_path / "bag" / "bag_10.mcap").exists()
    with BagReader(tmp_path / "bag") as reader:
        assert [m.stamp for m in reader.messages()] == list(range(60))


def test_a_copy_that_lies_beside_the_files_is_not_read(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", split_size=200, chunk_size=100) as bag:
        topic = bag.add_topic(Topic.of_type("/chatter", STRING))
        for stamp in range(60):
            bag.write(topic, stamp, b"x" * 20)
    for name in ("bag_0 copy.mcap", "first.mcap", "other_90.mcap"):
        shutil.copy(tmp_path / "bag" / "bag_0.mcap", tmp_path / "bag" / name)
    with BagReader(tmp_path / "bag") as reader:
        assert [m.stamp for m in reader.messages()] == list(range(60))
        assert reader.topics["/chatter"].count == 60
        assert reader.complete


def test_a_file_that_was_begun_when_the_recorder_was_killed_is_read(tmp_path: Path) -> None:
    """metadata.yaml does not name it yet."""
    bag = tmp_path / "bag"
    with BagWriter(bag) as writer:
        topic = writer.add_topic(Topic.of_type("/chatter", STRING))
        writer.write(topic, 0, b"")
        writer.flush()
        before = (bag / "metadata.yaml").read_bytes()
        writer.split(1)
        writer.write(topic, 1, b"")
    (bag / "metadata.yaml").write_bytes(before)
    with BagReader(bag) as reader:
        assert [m.stamp for m in reader.messages()] == [0, 1]


def test_a_bag_whose_file_was_renamed_is_read(tmp_path: Path) -> None:
    write_own(tmp_path / "bag")
    (tmp_path / "bag" / "bag_0.mcap").rename(tmp_path / "bag" / "drive.mcap")
    with BagReader(tmp_path / "bag") as reader:
        assert list(reader.messages()) == MESSAGES
        assert not reader.complete


def test_a_part_that_was_only_begun_hides_no_other(tmp_path: Path) -> None:
    write_own(tmp_path / "bag")
    (tmp_path / "bag" / "bag_1.mcap").touch()
    with BagReader(tmp_path / "bag") as reader:
        assert list(reader.messages()) == MESSAGES
        assert not reader.complete


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda path: None, "no such bag"),
        (lambda path: path.mkdir(), "holds no metadata.yaml and no .mcap file"),
        (lambda path: path.write_text("hello"), "needs a rosbag2 directory, .mcap or .db3 file"),
        (lambda path: BagWriter(path).close(), "empty bag: no topic was recorded$"),
    ],
    ids=["missing", "no bag", "text", "empty"],
)
def test_what_is_no_bag_is_named(tmp_path: Path, make, message: str) -> None:  # type: ignore[no-untyped-def]
    make(tmp_path / "bag")
    with pytest.raises(BagError, match=message) as error:
        BagReader(tmp_path / "bag")
    assert "\n" not in str(error.value)


def test_files_that_are_not_what_they_are_called(tmp_path: Path) -> None:
    for name in ("a.mcap", "a.db3"):
        (tmp_path / name).write_text("no bag at all, whatever its name says")
        with pytest.raises(BagError, match=name):
            BagReader(tmp_path / name)
    (tmp_path / "empty.mcap").touch()
    with pytest.raises(BagError, match="is empty"):
        BagReader(tmp_path / "empty.mcap")
    content = (write_own(tmp_path / "bag") / "bag_0.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(content[:20])
    with pytest.raises(BagError, match="or it was cut off before its first message"):
        BagReader(tmp_path / "cut.mcap")
    (tmp_path / "bag" / "metadata.yaml").write_text("- a\n- b\n")
    with BagReader(tmp_path / "bag") as reader:  # the files have all that is needed
        assert list(reader.messages()) == MESSAGES
    (tmp_path / "bag" / "bag_0.mcap").unlink()
    with pytest.raises(BagError, match="not a rosbag2 metadata file"):
        BagReader(tmp_path / "bag")


def test_a_topic_of_two_types_is_refused(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as bag:
        bag.add_topic(Topic.of_type("/chatter", STRING))
        bag.add_topic(Topic.of_type("/chatter", "std_msgs/msg/Header"))
    with pytest.raises(BagError, match="two types"):
        BagReader(tmp_path / "bag")


def test_decode_tells_unknown_types_and_wrong_bytes() -> None:
    with pytest.raises(BagError, match="unknown type 'a/msg/B'"):
        deserialize("a/msg/B", b"")
    with pytest.raises(BagError, match="2 bytes are not a message nav_msgs/msg/Odometry"):
        deserialize("nav_msgs/msg/Odometry", b"\0\1")


@pytest.mark.slow
def test_a_foreign_directory_with_missing_files(tmp_path: Path) -> None:
    write_with_rosbags(tmp_path / "bag", StoragePlugin.SQLITE3, CompressionMode.NONE)
    shutil.move(tmp_path / "bag" / "bag.db3", tmp_path / "elsewhere.db3")
    with pytest.raises(BagError, match="missing"):
        BagReader(tmp_path / "bag")


@pytest.mark.slow
def test_memory_does_not_grow_with_the_bag(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", compression=Compression.NONE) as bag:
        topic = bag.add_topic(Topic.of_type("/chatter", STRING))
        for stamp in range(150):
            bag.write(topic, stamp, bytes(10**6))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with BagReader(tmp_path / "bag") as reader:
        assert sum(len(message.data) for message in reader.messages()) == 150 * 10**6
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 30_000  # KiB


@pytest.mark.parametrize("first", ["first", "bags/01"])
def test_a_folder_of_bags_names_one_of_them(tmp_path, first):
    (tmp_path / first).mkdir(parents=True)
    (tmp_path / first / "metadata.yaml").touch()
    with pytest.raises(BagError, match=f"is not a bag: .*; it holds bags, as {tmp_path}/{first}"):
        BagReader(tmp_path)
