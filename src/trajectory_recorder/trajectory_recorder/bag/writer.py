"""Writing of rosbag2 directories (``metadata.yaml`` and MCAP files) without ROS.

A bag that is being written is complete: every `BagWriter.flush` writes all messages since the
last one *and* the file's summary and footer behind them; the next flush overwrites that summary. A
process that is killed thus leaves a bag that any reader opens, with everything up to the last flush
in it. Only a process killed within the write itself leaves an incomplete summary; `BagReader` reads
such a file up to that place.

The records are those of https://mcap.dev/spec, the directory that of rosbag2 (metadata version 9).
"""

import os
import shutil
import struct
import zlib
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from enum import Enum
from itertools import islice
from pathlib import Path
from typing import Any

import lz4.frame
import zstandard
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from trajectory_recorder.bag.metadata import dump_yaml, write_metadata
from trajectory_recorder.bag.records import (
    CHUNK,
    FAILURE,
    MAGIC,
    MESSAGE_INDEX,
    METADATA_RECORD,
    RECORD,
    serialize,
)
from trajectory_recorder.bag.topics import Topic
from tricycle_core.closing import Closing
from tricycle_core.errors import BagError

_MESSAGE = struct.Struct("<BQHIQQ")  # `RECORD` and `MESSAGE` in one, for speed
_MESSAGE_FIELDS = _MESSAGE.size - RECORD.size  # bytes of the content that are not data
_PENDING_BYTES = 8 * 2**20  # chunks kept before the file, and with it its summary, is written
_PENDING_TAILS = 4  # and not before they are so much more than that summary, which grows
_CACHED_BYTES = 2**27  # of a file that is being written are left in the machine's memory

_BUFFERS = 64  # in one call to the operating system

LARGE = 2**14
"""Bytes from which a message, and those of its topic after it, are kept apart from small ones."""


class Compression(Enum):
    """Compression of chunks."""

    NONE = ""
    LZ4 = "lz4"
    ZSTD = "zstd"


def check_new(path: Path) -> None:
    """Refuse a bag that would overwrite something.

    Parameters
    ----------
    path : Path
        Directory of a bag to be written.

    Raises
    ------
    BagError
        If it exists.
    """
    if path.exists():
        raise BagError(f"{path} exists: a bag is not overwritten, choose another name")


@dataclass
class _Chunk:
    """Messages that wait to be written."""

    pieces: list[bytes] = field(default_factory=list)  # a large message is not copied until written
    size: int = 0  # bytes
    index: dict[int, list[int]] = field(default_factory=dict)  # topic id -> stamp, offset, stamp, …


class BagWriter(Closing):
    """A rosbag2 directory being written.

    Topics with large messages, as images, have chunks of their own: who reads the others from
    elsewhere need not fetch them.

    Latched topics (every publisher offers transient-local) are repeated at the beginning of each
    further file, stamped with the time of the split, so that every file can be used alone.

    Parameters
    ----------
    path : Path
        Directory to create; its parents are created too.
    compression : Compression
        Compression of the chunks.
    chunk_size : int
        Size of a chunk before compression [bytes].
    split_size : int
        Size after which the next file is begun, without the repeated messages at its beginning
        [bytes]; 0 for never.
    split_duration : float
        Time between stamps after which the next file is begun [s]; 0 for never.
    metadata : mapping of str to str, optional
        Notes about the drive, e.g. plan id and versions; may be added to later.

    Raises
    ------
    BagError
        If the directory exists: no bag is ever overwritten. From `write`, if a stamp is negative.
    OSError
        From any method, when the disk fails or is full, or the file was deleted or changed by
        another program. The file then holds what was flushed before and is a readable bag; the
        writer can only be closed.
    """

    def __init__(
        self,
        path: Path,
        *,
        compression: Compression = Compression.ZSTD,
        chunk_size: int = 2**20,
        split_size: int = 0,
        split_duration: float = 0.0,
        metadata: Mapping[str, str] | None = None,
    ) -> None:
        check_new(path)
        path.mkdir(parents=True)
        self.path = path
        self.metadata = dict(metadata or {})
        self.messages = 0
        self._compress = _compressor(compression)
        self._compression = compression
        self._chunk_size = chunk_size
        self._split_size = split_size
        self._split_duration = round(split_duration * 1e9)
        self._topics: list[Topic] = []  # a topic's id is its place here + 1
        self._latched: dict[int, deque[bytes]] = {}  # last messages, as many as offered
        self._chunks = _Chunk(), _Chunk()  # of topics with small and with large messages
        self._large: set[int] = set()  # ids of topics that have had a large one
        self._begun: int | None = None  # first stamp of the present file
        self._repeated = 0  # bytes at its beginning that are repeated messages
        self._information: dict[str, Any] = {}  # in metadata.yaml
        try:
            self._files = [_OutputFile(self._next_path(0))]
            self.flush()
        except OSError:
            shutil.rmtree(path, ignore_errors=True)
            raise

    @property
    def size(self) -> int:
        """Bytes of all files, finished chunks only."""
        return sum(file.size for file in self._files)

    def add_topic(self, topic: Topic) -> int:
        """Begin a topic; return its id for `write`."""
        self._topics.append(topic)
        topic_id = len(self._topics)
        self.offered(topic_id, topic)
        self._files[-1].add_channel(topic_id, topic)
        return topic_id

    def offered(self, topic_id: int, topic: Topic) -> None:
        """Note that a topic is offered otherwise from now on, for example by more publishers.

        Parameters
        ----------
        topic_id : int
            Number of the topic, from `add_topic`.
        topic : Topic
            Topic with the same name and type.
        """
        self._topics[topic_id - 1] = topic
        latched = self._latched.pop(topic_id, ())
        if topic.latched:
            depth = sum(max(qos.depth, 1) for qos in topic.qos)
            self._latched[topic_id] = deque(latched, maxlen=depth)

    def write(self, topic_id: int, stamp: int, data: bytes, published: int | None = None) -> None:
        """Append a message.

        Parameters
        ----------
        topic_id : int
            Number of the topic, from `add_topic`.
        stamp : int
            Time of receipt [ns].
        data : bytes
            Serialised message (CDR).
        published : int, optional
            Time of its publication [ns]. Default: the stamp.
        """
        if self._split_due(stamp):
            self._split(stamp)
        chunk = self._append(topic_id, stamp, data, stamp if published is None else published)
        self.messages += 1
        if topic_id in self._latched:
            self._latched[topic_id].append(data)
        if chunk.size >= self._chunk_size:
            self._finish(chunk)
            if self._files[-1].flush_due:
                self._files[-1].flush(self.metadata)

    def flush(self) -> None:
        """Make the bag on disk complete; a process killed later loses what comes after this."""
        self._finish(*self._chunks)
        self._files[-1].flush(self.metadata)
        self._write_metadata()

    def split(self, stamp: int) -> None:
        """Begin the next file; nothing where the present one is empty.

        Parameters
        ----------
        stamp : int
            Time now, of the latched messages [ns].
        """
        self._finish(*self._chunks)
        if self._files[-1].messages:
            self._split(stamp)

    def close(self) -> None:
        """Flush and close; further calls do nothing."""
        file = self._files[-1]
        try:
            if not file.closed:
                self.flush()
        finally:
            file.close()

    def fail(self, reason: str) -> None:
        """Close a bag that ends early, and note why in its metadata if the disk allows it.

        Parameters
        ----------
        reason : str
            Reason, for the metadata.
        """
        self.metadata[FAILURE] = reason
        with suppress(OSError):
            self.close()
        with suppress(OSError):  # the file may be full, this one is small
            write_metadata(self.path, self._information | {"custom_data": dict(self.metadata)})

    def _append(self, topic_id: int, stamp: int, data: bytes, published: int) -> _Chunk:
        size = len(data)
        length = _MESSAGE_FIELDS + size
        try:
            head = _MESSAGE.pack(Opcode.MESSAGE, length, topic_id, 0, stamp, published)
        except struct.error as error:
            raise BagError(f"{self.path}: no bag holds the stamp {stamp} ns") from error
        if self._begun is None:
            self._begun = stamp
        if size >= LARGE and topic_id not in self._large:
            self._finish(*self._chunks)  # a topic's messages stay in order
            self._large.add(topic_id)
        chunk = self._chunks[topic_id in self._large]
        entries = chunk.index.get(topic_id)
        if entries is None:
            entries = chunk.index[topic_id] = []
        entries += (stamp, chunk.size)
        chunk.pieces.append(head)
        chunk.pieces.append(data)
        chunk.size += _MESSAGE.size + size
        return chunk

    def _finish(self, *chunks: _Chunk) -> None:
        for chunk in chunks:
            if chunk.pieces:
                pieces, index = chunk.pieces, chunk.index
                chunk.pieces, chunk.size, chunk.index = [], 0, {}
                self._files[-1].add_chunk(pieces, index, self._compression, self._compress)

    def _next_path(self, number: int) -> Path:
        return self.path / f"{self.path.name}_{number}.mcap"

    def _split_due(self, stamp: int) -> bool:
        file = self._files[-1]
        size = file.size - self._repeated
        return (0 < self._split_size <= size and file.messages > 0) or (
            0 < self._split_duration <= (0 if self._begun is None else stamp - self._begun)
        )

    def _split(self, stamp: int) -> None:
        self.close()
        self._begun = None
        self._files.append(_OutputFile(self._next_path(len(self._files))))
        for topic_id, topic in enumerate(self._topics, start=1):
            self._files[-1].add_channel(topic_id, topic)
        for topic_id, last in self._latched.items():
            for data in last:
                self._append(topic_id, stamp, data, stamp)
        self.flush()
        self._repeated = self._files[-1].size

    def _write_metadata(self) -> None:
        files = [file for file in self._files if file.messages]
        start = min((file.start for file in files), default=0)
        end = max((file.end for file in files), default=0)
        self._information = {
            "storage_identifier": "mcap",
            "duration": {"nanoseconds": end - start},
            "starting_time": {"nanoseconds_since_epoch": start},
            "message_count": sum(file.messages for file in files),
            "topics_with_message_count": [
                {
                    "topic_metadata": {
                        "name": topic.name,
                        "type": topic.type,
                        "serialization_format": topic.encoding,
                        "offered_qos_profiles": [qos.to_yaml() for qos in topic.qos],
                        "type_description_hash": topic.type_hash,
                    },
                    "message_count": sum(file.counts.get(topic_id, 0) for file in self._files),
                }
                for topic_id, topic in enumerate(self._topics, start=1)
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [file.path.name for file in self._files],
            "files": [
                {
                    "path": file.path.name,
                    "starting_time": {"nanoseconds_since_epoch": file.start},
                    "duration": {"nanoseconds": file.end - file.start},
                    "message_count": file.messages,
                }
                for file in self._files
            ],
            "custom_data": dict(self.metadata) or None,
            "ros_distro": "jazzy",
        }
        write_metadata(self.path, self._information)


@contextmanager
def whole_or_none(writer: BagWriter) -> Iterator[BagWriter]:
    """Close a bag when the block ends without an error; otherwise remove it.

    Parameters
    ----------
    writer : BagWriter
        Writer of a bag that can be made again.

    Yields
    ------
    writer : BagWriter
        The same.
    """
    try:
        with writer:
            yield writer
    except BaseException:
        shutil.rmtree(writer.path, ignore_errors=True)
        raise


class _OutputFile:
    """One MCAP file, complete after each `flush`."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.start = 0  # ns, smallest stamp
        self.end = 0
        self.counts: dict[int, int] = {}  # channel id -> messages
        self.closed = False
        # by name, encoding and text of the type
        self._schemas: dict[tuple[str, str, str], Schema] = {}
        self._channels: list[Channel] = []
        self._chunks = 0
        self._chunk_indexes = bytearray()  # encoded: there may be many, and each tail has them all
        header = MAGIC + serialize(Header(profile="ros2", library="trajectory_recorder"))
        self._pending: list[bytes] = [header]
        self.pending_bytes = len(header)
        self._data_end = 0  # bytes on disk that are never touched again
        self._tail = b""  # what follows them: summary, footer
        self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o644)

    @property
    def size(self) -> int:
        """Bytes written and pending, without the summary."""
        return self._data_end + self.pending_bytes

    @property
    def messages(self) -> int:
        """Messages in finished chunks."""
        return sum(self.counts.values())

    @property
    def flush_due(self) -> bool:
        """Whether enough is pending for the price of a new tail."""
        return self.pending_bytes >= max(_PENDING_BYTES, _PENDING_TAILS * len(self._tail))

    def add_channel(self, channel_id: int, topic: Topic) -> None:
        """Add the schema, when it is new, and the channel of a topic."""
        key = (topic.type, topic.definition_encoding, topic.definition)
        schema = self._schemas.get(key)
        if schema is None:
            schema = Schema(
                id=len(self._schemas) + 1,
                name=topic.type,
                encoding=topic.definition_encoding if topic.definition else "",
                data=topic.definition.encode(errors="surrogateescape"),
            )
            self._schemas[key] = schema
            self._add(serialize(schema))
        channel = Channel(
            id=channel_id,
            schema_id=schema.id,
            topic=topic.name,
            message_encoding=topic.encoding,
            metadata={
                "offered_qos_profiles": dump_yaml([qos.to_yaml() for qos in topic.qos]),
                "topic_type_hash": topic.type_hash,
            },
        )
        self._channels.append(channel)
        self._add(serialize(channel))

    def add_chunk(
        self,
        chunk: list[bytes],
        index: Mapping[int, list[int]],
        compression: Compression,
        compress: Callable[[list[bytes]], list[bytes]],
    ) -> None:
        """Add a chunk of message records; index: channel id -> stamp, offset, stamp, offset, ..."""
        if len(chunk) > _BUFFERS:
            chunk = [b"".join(chunk)]
        crc = 0
        for piece in chunk:
            crc = zlib.crc32(piece, crc)
        data = compress(chunk)
        size, compressed_size = sum(map(len, chunk)), sum(map(len, data))
        start = min(min(entries[::2]) for entries in index.values())
        end = max(max(entries[::2]) for entries in index.values())
        name = compression.value.encode()
        offset = self.size
        head = CHUNK.pack(start, end, size, crc, len(name)) + name
        head += struct.pack("<Q", compressed_size)
        self._add(RECORD.pack(Opcode.CHUNK, len(head) + compressed_size) + head)
        for piece in data:
            self._add(piece)
        chunk_end = self.size
        index_offsets = {}
        for channel_id, entries in index.items():
            index_offsets[channel_id] = self.size
            packed = struct.pack(f"<{len(entries)}Q", *entries)
            self._add(
                MESSAGE_INDEX.pack(Opcode.MESSAGE_INDEX, 6 + len(packed), channel_id, len(packed))
                + packed
            )
            self.counts[channel_id] = self.counts.get(channel_id, 0) + len(entries) // 2
        self._chunk_indexes += serialize(
            ChunkIndex(
                chunk_start_offset=offset,
                chunk_length=chunk_end - offset,
                message_start_time=start,
                message_end_time=end,
                message_index_offsets=index_offsets,
                message_index_length=self.size - chunk_end,
                compression=compression.value,
                compressed_size=compressed_size,
                uncompressed_size=size,
            )
        )
        self.start = min(start, self.start) if self._chunks else start
        self.end = max(end, self.end)
        self._chunks += 1

    def flush(self, metadata: Mapping[str, str]) -> None:
        """Write what is pending and a new tail behind it."""
        if self.closed:
            raise OSError(f"{self.path} is closed")
        self._check_untouched()
        tail = self._make_tail(metadata)
        if not self._pending and tail == self._tail:
            return
        try:
            _write_at(self._fd, self._data_end, [*self._pending, tail])
        except OSError as error:
            # The disk is full: the old tail fits, it was there before.
            with suppress(OSError):
                _write_at(self._fd, self._data_end, [self._tail])
                os.ftruncate(self._fd, self._data_end + len(self._tail))
            self.close()
            raise OSError(error.errno, error.strerror, str(self.path)) from error
        if self.size + len(tail) < self._data_end + len(self._tail):
            os.ftruncate(self._fd, self.size + len(tail))
        self._data_end, self._tail = self.size, tail
        self._pending, self.pending_bytes = [], 0
        if self._data_end > _CACHED_BYTES:
            # On to the disk, and its memory serves the next write: taking more and more memory
            # would halve the rate, and push out what others have there.
            written = self._data_end - _CACHED_BYTES
            os.posix_fadvise(self._fd, 0, written, os.POSIX_FADV_DONTNEED)

    def close(self) -> None:
        """Close without flushing; further calls do nothing."""
        if not self.closed:
            self.closed = True
            os.close(self._fd)

    def _check_untouched(self) -> None:
        """Close and raise where somebody else deleted or changed the file."""
        file = os.fstat(self._fd)
        expected = self._data_end + len(self._tail)
        if file.st_nlink and file.st_size == expected:
            return
        self.close()
        what = f"has {file.st_size} bytes instead of {expected}" if file.st_nlink else "was deleted"
        raise OSError(f"{self.path} {what}: another program touched it")

    def _add(self, data: bytes) -> None:
        self._pending.append(data)
        self.pending_bytes += len(data)

    def _make_tail(self, metadata: Mapping[str, str]) -> bytes:
        """Metadata record, end of data, summary with its offsets, footer, magic."""
        record = serialize(Metadata(name=METADATA_RECORD, metadata=dict(metadata)))
        data_end = record + serialize(DataEnd(data_section_crc=0))
        statistics = Statistics(
            message_count=self.messages,
            schema_count=len(self._schemas),
            channel_count=len(self._channels),
            attachment_count=0,
            metadata_count=1,
            chunk_count=self._chunks,
            message_start_time=self.start,
            message_end_time=self.end,
            channel_message_counts=dict(self.counts),
        )
        metadata_index = MetadataIndex(offset=self.size, length=len(record), name=METADATA_RECORD)
        groups: dict[Opcode, bytes | bytearray] = {
            Opcode.SCHEMA: serialize(*self._schemas.values()),
            Opcode.CHANNEL: serialize(*self._channels),
            Opcode.STATISTICS: serialize(statistics),
            Opcode.CHUNK_INDEX: self._chunk_indexes,
            Opcode.METADATA_INDEX: serialize(metadata_index),
        }
        summary_start = self.size + len(data_end)
        summary = bytearray()
        offsets = []
        for opcode, group in groups.items():
            if group:
                offsets.append(
                    SummaryOffset(
                        group_opcode=opcode,
                        group_start=summary_start + len(summary),
                        group_length=len(group),
                    )
                )
                summary += group
        offset_start = summary_start + len(summary)
        summary += serialize(*offsets)
        # the CRC includes the footer up to its own place
        footer = Footer(
            summary_start=summary_start, summary_offset_start=offset_start, summary_crc=0
        )
        footer.summary_crc = zlib.crc32(summary + serialize(footer)[:-4])
        return data_end + bytes(summary) + serialize(footer) + MAGIC


def _write_at(fd: int, offset: int, buffers: Sequence[bytes]) -> None:
    """Write all the buffers, however many calls it takes."""
    left = deque(memoryview(buffer) for buffer in buffers)
    while left:
        written = os.pwritev(fd, list(islice(left, _BUFFERS)), offset)
        offset += written
        while left and written >= len(left[0]):
            written -= len(left.popleft())
        if left:
            left[0] = left[0][written:]


def _compressor(compression: Compression) -> Callable[[list[bytes]], list[bytes]]:
    if compression is Compression.ZSTD:
        compressor = zstandard.ZstdCompressor(level=1)
        return lambda chunk: [compressor.compress(b"".join(chunk))]
    if compression is Compression.LZ4:
        return lambda chunk: [bytes(lz4.frame.compress(b"".join(chunk)))]
    return lambda chunk: chunk
