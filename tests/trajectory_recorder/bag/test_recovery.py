"""Recovery of bags that other readers refuse."""

import errno
import os
import re
from pathlib import Path

import pytest
from mcap.opcode import Opcode
from mcap.reader import make_reader

from trajectory_recorder.bag.mcap_file import LocalFile
from trajectory_recorder.bag.reader import BagReader
from trajectory_recorder.bag.records import RECORD
from trajectory_recorder.bag.recovery import recover
from trajectory_recorder.bag.topics import Topic
from trajectory_recorder.bag.writer import BagWriter, Compression
from tricycle_core.errors import BagError

COUNT = 3000


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    with BagWriter(
        tmp_path / "bag", chunk_size=2000, compression=Compression.NONE, metadata={"plan_id": "p"}
    ) as writer:
        topic = writer.add_topic(Topic.of_type("/chatter", "std_msgs/msg/String"))
        for i in range(COUNT):
            writer.write(topic, i, b"%06d" % i)
    return tmp_path / "bag"


def contents(bag: Path) -> list[bytes]:
    with BagReader(bag) as reader:
        return [message.data for message in reader.messages()]


def test_a_torn_bag_becomes_one_that_any_reader_opens(bag: Path, tmp_path: Path) -> None:
    file = bag / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    told: list[tuple[int, int]] = []
    found = recover(
        bag, tmp_path / "whole", progress=lambda done, total: told.append((done, total))
    )
    (damage,) = found.damage
    at = int(re.search(r"damaged at byte (\d+)", str(damage))[1])
    assert str(damage).endswith(f"the last {file.stat().st_size - at} bytes are no whole records")
    assert not found.complete
    assert 0 < found.messages < COUNT
    assert told[-1] == (found.messages, found.messages)
    assert contents(tmp_path / "whole") == [b"%06d" % i for i in range(found.messages)]
    with BagReader(tmp_path / "whole") as reader:
        assert not reader.complete  # what came after the tear is not known
        assert reader.metadata == {
            "plan_id": "p",
            "lost": "parts of a bag that was not whole; damaged parts of bag: 1",
        }
    with (tmp_path / "whole" / "whole_0.mcap").open("rb") as stream:
        assert make_reader(stream).get_summary().statistics.message_count == found.messages


@pytest.mark.parametrize("torn", [0, 20])
def test_a_damaged_chunk_is_left_out_and_named(bag: Path, tmp_path: Path, torn: int) -> None:
    """Also where the summary is lost, and with it where the chunks are."""
    file = bag / "bag_0.mcap"
    content = bytearray(file.read_bytes())
    at = content.index(b"%06d" % 1000)
    content[at : at + 6] = b"damage"
    file.write_bytes(content[: len(content) - torn])
    found = recover(bag, tmp_path / "whole")
    (damage,) = found.damage
    assert not found.complete
    assert "damaged at byte" in str(damage)
    with BagReader(tmp_path / "whole") as reader:
        assert not reader.complete
        assert "damaged parts of bag: 1" in reader.metadata["lost"]
    kept = contents(tmp_path / "whole")
    assert len(kept) == found.messages
    assert COUNT - 100 < len(kept) < COUNT
    assert b"%06d" % 1000 not in kept


@pytest.mark.parametrize(
    ("head", "reason"),
    [
        (RECORD.pack(Opcode.CHUNK, 2**50), r"damaged at byte \d+: the last \d+ bytes are no whole"),
        (RECORD.pack(Opcode.FOOTER, 2000), r"damaged at byte \d+: the last \d+ bytes are no whole"),
        (bytes(9), r"damaged at byte \d+: the last \d+ bytes are no whole records"),
        (b"\x46", r"damaged at byte \d+: no record has the opcode 70"),
    ],
)
def test_the_damaged_head_of_a_chunk_is_told(
    bag: Path, tmp_path: Path, head: bytes, reason: str
) -> None:
    """Where the summary is lost too, nothing else shows what is left out."""
    file = bag / "bag_0.mcap"
    with file.open("rb") as stream:
        at = make_reader(stream).get_summary().chunk_indexes[5].chunk_start_offset
    content = bytearray(file.read_bytes())
    content[at : at + len(head)] = head
    file.write_bytes(content[:-50])
    found = recover(bag, tmp_path / "whole")
    (damage,) = found.damage
    assert re.search(reason, str(damage))
    assert f"at byte {at}:" in str(damage)
    assert not found.complete


@pytest.mark.parametrize("part", ["chunk", "summary"])
def test_what_a_disk_does_not_give_back_is_left_out(
    bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, part: str
) -> None:
    """Bad sectors: everything else is recovered."""
    file = bag / "bag_0.mcap"
    with file.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    index = summary.chunk_indexes[5]
    bad = index.chunk_start_offset + 100 if part == "chunk" else file.stat().st_size - 1
    read = LocalFile.read

    def failing(self: LocalFile, start: int, size: int) -> bytes:
        if start <= bad < start + size:
            raise OSError(errno.EIO, os.strerror(errno.EIO), str(file))
        return read(self, start, size)

    monkeypatch.setattr(LocalFile, "read", failing)
    found = recover(bag, tmp_path / "new")
    if part == "chunk":
        (damage,) = found.damage
        assert str(damage) == (
            f"{file}: damaged at byte {index.chunk_start_offset}: {os.strerror(errno.EIO)}"
        )
        assert COUNT - 100 < found.messages < COUNT
        with BagReader(bag) as reader, pytest.raises(BagError, match="Input/output error"):
            list(reader.messages())
    else:
        assert (found.damage, found.messages, found.complete) == ((), COUNT, False)


def test_a_server_that_fails_is_no_damage(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read, answers = LocalFile.read, True

    def answering(self: LocalFile, start: int, size: int) -> bytes:
        if not answers:
            raise BagError("no answer")
        return read(self, start, size)

    monkeypatch.setattr(LocalFile, "read", answering)
    with BagReader(bag, damaged=lambda damage: None) as reader:
        answers = False
        with pytest.raises(BagError, match=r"^no answer$"):
            list(reader.messages())
    with pytest.raises(BagError, match=r"^no answer$"):
        BagReader(bag, damaged=lambda damage: None)


def test_messages_whose_topic_is_lost_are_told(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        for i in range(2):
            topic = writer.add_topic(Topic.of_type(f"/chatter{i}", "std_msgs/msg/String"))
            writer.write(topic, i, b"%d" % i)
            writer.flush()
    file = tmp_path / "bag" / "bag_0.mcap"
    content = bytearray(file.read_bytes())
    at = content.index(b"/chatter1") - 17
    assert content[at] == Opcode.CHANNEL
    content[at] = Opcode.METADATA
    file.write_bytes(content[:-50])
    found = recover(tmp_path / "bag", tmp_path / "new")
    assert [str(damage) for damage in found.damage] == [
        f"{file}: the topics of 1 messages are lost"
    ]
    assert not found.complete
    assert contents(tmp_path / "new") == [b"0"]


def test_a_bag_that_lacks_a_file_does_not_become_whole(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        topic = writer.add_topic(Topic.of_type("/chatter", "std_msgs/msg/String"))
        for i in range(3):
            writer.split(i)
            writer.write(topic, i, b"%d" % i)
    (tmp_path / "bag" / "bag_1.mcap").unlink()
    found = recover(tmp_path / "bag", tmp_path / "new")
    assert [str(damage) for damage in found.damage] == [
        f"{tmp_path / 'bag'}: its file bag_1.mcap is missing"
    ]
    assert not found.complete
    assert contents(tmp_path / "new") == [b"0", b"2"]
    with BagReader(tmp_path / "new") as reader:
        assert not reader.complete


def test_a_whole_bag_stays_whole(bag: Path, tmp_path: Path) -> None:
    assert recover(bag, tmp_path / "new").complete
    with BagReader(tmp_path / "new") as reader:
        assert reader.complete
        assert reader.metadata == {"plan_id": "p"}


def test_a_link_to_itself_is_no_bag(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with pytest.raises(BagError, match="no such bag"):
        recover(tmp_path / "loop", tmp_path / "new")


def test_nothing_is_overwritten(bag: Path) -> None:
    with pytest.raises(BagError, match="exists"):
        recover(bag, bag)


def test_nothing_to_recover_is_an_error_and_leaves_no_bag(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic(Topic.of_type("/chatter", "std_msgs/msg/String"))
    with pytest.raises(BagError, match="no message can be read"):
        recover(tmp_path / "bag", tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_a_tail_of_zeros_ends_the_file(bag: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As a file system leaves it after a power loss: not read record by record of no bytes."""
    file = bag / "bag_0.mcap"
    data = file.read_bytes().partition(bytes([Opcode.DATA_END, 4, *bytes(7)]))[0]
    file.write_bytes(data + bytes(50_000))
    reads: list[int] = []
    read = LocalFile.read
    monkeypatch.setattr(LocalFile, "read", lambda *args: reads.append(1) or read(*args))
    assert contents(bag) == [b"%06d" % i for i in range(COUNT)]
    assert len(reads) < 500


@pytest.mark.parametrize("number", [0, 1])
def test_a_file_of_a_split_bag_that_is_none_keeps_no_other_back(
    tmp_path: Path, number: int
) -> None:
    """As zeros in place of its content, which a power loss leaves."""
    bag = tmp_path / "bag"
    with BagWriter(bag) as writer:
        topic = writer.add_topic(Topic.of_type("/chatter", "std_msgs/msg/String"))
        for i in range(3):
            writer.split(i)
            writer.write(topic, i, b"%d" % i)
    (bag / f"bag_{number}.mcap").write_bytes(bytes(4096))
    with pytest.raises(BagError, match=f"bag_{number}.mcap is not an MCAP file"):
        BagReader(bag)
    found = recover(bag, tmp_path / "new")
    (damage,) = found.damage
    assert f"bag_{number}.mcap is not an MCAP file" in str(damage)
    assert contents(tmp_path / "new") == [b"%d" % i for i in range(3) if i != number]
    with BagReader(tmp_path / "new") as reader:
        assert not reader.complete
