"""Writing of rosbag2 directories (``metadata.yaml`` and MCAP files) without ROS.

A bag that is being written is complete: every `BagWriter.flush` writes all messages since the
last one *and* the file's summary and footer behind them; the next flush overwrites that summary. A
process that is killed thus leaves a bag that any reader opens, with everything up to the last flush
in it. Only a process killed within the write itself leaves an incomplete summary; `BagReader` reads
such a file up to that place.

The records are those of https://mcap.dev/spec, the directory that of rosbag2 (metadata version 9).
"""

import shutil
import struct
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

import lz4.frame
import zstandard
from mcap.opcode import Opcode

from trajectory_recorder.bag.location import scheme_of
from trajectory_recorder.bag.mcap_output import McapOutput
from trajectory_recorder.bag.metadata import write_metadata
from trajectory_recorder.bag.records import FAILURE, RECORD
from trajectory_recorder.bag.topics import Topic
from tricycle_core.closing import Closing
from tricycle_core.errors import BagError

_MESSAGE = struct.Struct("<BQHIQQ")  # `RECORD` and `MESSAGE` in one, for speed
_MESSAGE_FIELDS = _MESSAGE.size - RECORD.size  # bytes of the content that are not data

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
        If it exists, or is a URL.
    """
    if scheme := scheme_of(path):
        raise BagError(f"{scheme}://…: bags are written on this computer only; copy it there then")
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
        If the directory exists: no bag is ever overwritten; or is a URL. From `write`, if a stamp
        is negative.
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
            self._files = [self._new_file(0)]
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
            self._latched[topic_id] = deque(latched, maxlen=topic.latched_depth)

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
                self._files[-1].add_chunk(pieces, index)

    def _new_file(self, number: int) -> McapOutput:
        path = self.path / f"{self.path.name}_{number}.mcap"
        return McapOutput(path, self._compression.value, self._compress)

    def _split_due(self, stamp: int) -> bool:
        file = self._files[-1]
        size = file.size - self._repeated
        return (0 < self._split_size <= size and file.messages > 0) or (
            0 < self._split_duration <= (0 if self._begun is None else stamp - self._begun)
        )

    def _split(self, stamp: int) -> None:
        self.close()
        self._begun = None
        self._files.append(self._new_file(len(self._files)))
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


def _compressor(compression: Compression) -> Callable[[list[bytes]], list[bytes]]:
    if compression is Compression.ZSTD:
        compressor = zstandard.ZstdCompressor(level=1)
        return lambda chunk: [compressor.compress(b"".join(chunk))]
    if compression is Compression.LZ4:
        return lambda chunk: [bytes(lz4.frame.compress(b"".join(chunk)))]
    return lambda chunk: chunk
