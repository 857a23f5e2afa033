"""Bags are read by `mcap`, `mcap-ros2-support` and `rosbags`, none of them ours."""

import os
import resource
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader as RosbagsReader

from trajectory_recorder.bag import mcap_output
from trajectory_recorder.bag.reader import BagReader
from trajectory_recorder.bag.topics import OfferedQos, Topic, jazzy
from trajectory_recorder.bag.writer import BagWriter, Compression
from tricycle_core.errors import BagError

SENSOR = (OfferedQos(depth=5, reliability="best_effort"),)
LATCHED = (OfferedQos(depth=1, durability="transient_local"),)


def string(text: str) -> bytes:
    store = jazzy()
    message = store.types["std_msgs/msg/String"](data=text)
    return bytes(store.serialize_cdr(message, "std_msgs/msg/String"))


def chatter(name: str = "/chatter", qos: tuple[OfferedQos, ...] = SENSOR) -> Topic:
    return Topic.of_type(name, "std_msgs/msg/String", qos=qos)


def read_with_rosbags(path: Path) -> list[tuple[str, int, str]]:
    with RosbagsReader(path) as reader:
        return [
            (c.topic, stamp, jazzy().deserialize_cdr(data, c.msgtype).data)  # type: ignore[attr-defined]
            for c, stamp, data, *_ in reader.messages()
        ]


def read_with_mcap(path: Path) -> list[tuple[str, int, str]]:
    support = pytest.importorskip("mcap_ros2.decoder")
    found = []
    for file in sorted(path.glob("*.mcap")):
        with file.open("rb") as stream:
            reader = make_reader(stream, decoder_factories=[support.DecoderFactory()])
            found += [
                (channel.topic, message.log_time, decoded.data)
                for _, channel, message, decoded in reader.iter_decoded_messages()
            ]
    return found


@pytest.mark.parametrize("compression", Compression)
def test_independent_readers_find_every_message(tmp_path: Path, compression: Compression) -> None:
    expected = [(f"/chatter{i % 2}", 10**18 + i, f"message {i}") for i in range(500)]
    with BagWriter(tmp_path / "bag", compression=compression, chunk_size=1000) as bag:
        ids = {name: bag.add_topic(chatter(name)) for name in ("/chatter0", "/chatter1")}
        for name, stamp, text in expected:
            bag.write(ids[name], stamp, string(text))
    assert read_with_rosbags(tmp_path / "bag") == expected
    assert read_with_mcap(tmp_path / "bag") == expected
    with BagReader(tmp_path / "bag") as reader:
        assert reader.complete
        assert [m.stamp for m in reader.messages(["/chatter1"])] == [
            stamp for name, stamp, _ in expected if name == "/chatter1"
        ]


def test_metadata_tells_types_hashes_quality_of_service_and_the_drive(tmp_path: Path) -> None:
    topic = Topic.of_type("/odom", "nav_msgs/msg/Odometry", qos=SENSOR)
    with BagWriter(tmp_path / "bag", metadata={"plan_id": "p1"}) as bag:
        bag.add_topic(topic)
        bag.metadata["firmware_version"] = "3"
    with RosbagsReader(tmp_path / "bag") as reader:
        (connection,) = reader.connections
        assert connection.digest == jazzy().hash_rihs01("nav_msgs/msg/Odometry")
        assert OfferedQos.of_connection(connection.ext.offered_qos_profiles[0]) == SENSOR[0]  # type: ignore[union-attr]
        assert "MSG: geometry_msgs/Quaternion" in connection.msgdef.data
        assert reader.ros_distro == "jazzy"
    with BagReader(tmp_path / "bag") as ours:
        assert ours.metadata == {"plan_id": "p1", "firmware_version": "3"}
        assert ours.topics["/odom"] == topic
    with (tmp_path / "bag" / "bag_0.mcap").open("rb") as stream:
        (record,) = make_reader(stream).iter_metadata()
        assert record.metadata == ours.metadata


def test_an_existing_bag_is_never_overwritten(tmp_path: Path) -> None:
    BagWriter(tmp_path / "bag").close()
    with pytest.raises(BagError, match="exists: a bag is not overwritten"):
        BagWriter(tmp_path / "bag")


def test_every_flush_leaves_a_complete_bag(tmp_path: Path) -> None:
    bag = BagWriter(tmp_path / "bag")
    topic = bag.add_topic(chatter())
    expected = []
    for i in range(5):
        expected.append(("/chatter", i, str(i) * 10))
        bag.write(topic, i, string(expected[-1][2]))
        bag.flush()
        assert read_with_rosbags(tmp_path / "bag") == expected
        assert read_with_mcap(tmp_path / "bag") == expected
    bag.close()
    assert read_with_rosbags(tmp_path / "bag") == expected


def test_latched_messages_above_the_split_size_do_not_begin_a_file_each(tmp_path: Path) -> None:
    with BagWriter(
        tmp_path / "bag", split_size=1000, chunk_size=100, compression=Compression.NONE
    ) as bag:
        plan, other = bag.add_topic(chatter("/plan", LATCHED)), bag.add_topic(chatter())
        bag.write(plan, 0, string("x" * 2000))
        bag.flush()
        for stamp in range(1, 51):
            bag.write(other, stamp, string("short"))
    assert 2 < len(list((tmp_path / "bag").glob("*.mcap"))) < 8


@pytest.mark.slow
def test_split_by_size_repeats_latched_topics_in_every_file(tmp_path: Path) -> None:
    with BagWriter(
        tmp_path / "bag", split_size=20_000, chunk_size=500, compression=Compression.NONE
    ) as bag:
        plan = bag.add_topic(chatter("/plan", LATCHED))
        other = bag.add_topic(chatter())
        bag.write(plan, 0, string("old plan"))
        bag.write(plan, 1, string("the plan"))
        for stamp in range(2, 2000):
            bag.write(other, stamp, string("x" * 50))
    files = sorted((tmp_path / "bag").glob("*.mcap"))
    assert len(files) > 3
    for file in files[1:]:
        with BagReader(file) as reader:
            assert [m.data for m in reader.messages(["/plan"])] == [string("the plan")]
        assert file.stat().st_size < 40_000
    with RosbagsReader(tmp_path / "bag") as reader:
        assert reader.message_count == 2000 + len(files) - 1
        assert reader.start_time == 0
        counts = {c.topic: c.msgcount for c in reader.connections}
    assert counts == {"/plan": 1 + len(files), "/chatter": 1998}
    stamps = [
        stamp for topic, stamp, _ in read_with_rosbags(tmp_path / "bag") if topic == "/chatter"
    ]
    assert stamps == list(range(2, 2000))


@pytest.mark.slow
def test_split_by_duration(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", split_duration=1.0) as bag:
        topic = bag.add_topic(chatter())
        for tenth in range(35):
            bag.write(topic, 5 * 10**9 + tenth * 10**8, string("x"))
            bag.flush()
    information = yaml.safe_load((tmp_path / "bag" / "metadata.yaml").read_text())
    files = information["rosbag2_bagfile_information"]["files"]
    assert [file["message_count"] for file in files] == [10, 10, 10, 5]


@pytest.mark.slow
def test_full_disk_leaves_what_was_flushed(tmp_path: Path) -> None:
    """A file size limit stands for a full disk: the write fails half done in the same way."""
    program = textwrap.dedent(
        """
        import resource, sys
        from pathlib import Path
        from trajectory_recorder.bag.writer import BagWriter, Compression
        from trajectory_recorder.bag.topics import Topic
        bag = BagWriter(Path(sys.argv[1]), compression=Compression.NONE)
        topic = bag.add_topic(Topic.of_type("/chatter", "std_msgs/msg/String"))
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, resource.RLIM_INFINITY))
        for i in range(1000):
            bag.write(topic, i, bytes.fromhex("00010000") + b"\\x65\\0\\0\\0" + b"x" * 100 + b"\\0")
            if i % 100 == 99:
                try:
                    bag.flush()
                except OSError as error:
                    print(i - 99)
                    bag.fail(str(error))
                    break
        """
    )
    result = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path / "bag")],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    kept = int(result.stdout)
    assert 0 < kept < 1000
    expected = [("/chatter", i, "x" * 100) for i in range(kept)]
    assert read_with_rosbags(tmp_path / "bag") == expected
    assert read_with_mcap(tmp_path / "bag") == expected
    with BagReader(tmp_path / "bag") as reader:
        assert "File too large" in reader.metadata["failure"]
        assert not reader.complete


def test_a_disk_that_takes_no_bag_is_left_as_it_was(tmp_path: Path) -> None:
    limit = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, limit[1]))
    try:
        with pytest.raises(OSError, match=r"File too large: .*bag_0.mcap"):
            BagWriter(tmp_path / "bag")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limit)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@given(
    payloads=st.lists(st.tuples(st.integers(0, 2**63 - 1), st.binary(max_size=300)), max_size=30),
    chunk_size=st.integers(1, 2000),
    compression=st.sampled_from(Compression),
    flush_every=st.integers(1, 10),
)
def test_any_bytes_at_any_time_come_back(
    tmp_path_factory: pytest.TempPathFactory,
    payloads: list[tuple[int, bytes]],
    chunk_size: int,
    compression: Compression,
    flush_every: int,
) -> None:
    path = tmp_path_factory.mktemp("bags") / "bag"
    with BagWriter(path, chunk_size=chunk_size, compression=compression) as bag:
        topic = bag.add_topic(chatter())
        for i, (stamp, data) in enumerate(payloads):
            bag.write(topic, stamp, data)
            if i % flush_every == 0:
                bag.flush()
    with BagReader(path) as reader:
        assert [(m.stamp, m.data) for m in reader.messages()] == payloads
    with (path / "bag_0.mcap").open("rb") as stream:
        records = make_reader(stream).iter_messages(log_time_order=False)
        assert [(message.log_time, message.data) for _, _, message in records] == payloads


def test_memory_does_not_grow_with_the_bag(tmp_path: Path) -> None:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with BagWriter(tmp_path / "bag", compression=Compression.NONE) as bag:
        topic = bag.add_topic(chatter())
        block = bytes(10**6)
        for stamp in range(100):
            bag.write(topic, stamp, block)
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert grown < 60_000  # KiB, for 100 MB written


def test_the_summary_of_a_long_bag_is_not_written_over_and_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written = 0
    pwritev = os.pwritev

    def counted(fd: int, buffers: list[memoryview], offset: int) -> int:
        nonlocal written
        count = pwritev(fd, buffers, offset)
        written += count
        return count

    monkeypatch.setattr(os, "pwritev", counted)
    monkeypatch.setattr(mcap_output, "_PENDING_BYTES", 2**12)
    with BagWriter(tmp_path / "bag", compression=Compression.NONE, chunk_size=1) as bag:
        topic = bag.add_topic(chatter())
        for stamp in range(3000):  # a chunk each, with its entry in the summary
            bag.write(topic, stamp, bytes(100))
    assert written < 3 * (tmp_path / "bag" / "bag_0.mcap").stat().st_size
