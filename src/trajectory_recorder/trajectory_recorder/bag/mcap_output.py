"""Writing of an MCAP file that is complete after each flush.

A flush writes what is pending and, behind it, the tail: metadata record, summary and footer. The
next flush overwrites that tail.
"""

import os
import struct
import zlib
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path

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

from trajectory_recorder.bag.metadata import dump_yaml
from trajectory_recorder.bag.records import (
    CHUNK,
    MAGIC,
    MESSAGE_INDEX,
    METADATA_RECORD,
    RECORD,
    serialize,
)
from trajectory_recorder.bag.topics import Topic

_PENDING_BYTES = 8 * 2**20  # chunks kept before the file, and with it its summary, is written
_PENDING_TAILS = 4  # and not before they are so much more than that summary, which grows
_CACHED_BYTES = 2**27  # of a file that is being written are left in the machine's memory

_BUFFERS = 64  # in one call to the operating system


class McapOutput:
    """One MCAP file, complete after each `flush`.

    Parameters
    ----------
    path : Path
        File to create.
    compression : str
        Compression of the chunks, as MCAP names it.
    compress : callable
        Compresses the pieces of a chunk.

    Attributes
    ----------
    start, end : int
        Smallest and largest stamp [ns].
    counts : dict of int to int
        Number of messages in finished chunks, by topic id.
    closed : bool
        Whether nothing can be written any more.

    Raises
    ------
    OSError
        From any method, when the disk fails or is full, or another program touched the file.
    """

    def __init__(
        self, path: Path, compression: str, compress: Callable[[list[bytes]], list[bytes]]
    ) -> None:
        self.path = path
        self._compression = compression
        self._compress = compress
        self.start = self.end = 0
        self.counts: dict[int, int] = {}
        self.closed = False
        # by name, encoding and text of the type
        self._schemas: dict[tuple[str, str, str], Schema] = {}
        self._channels: list[Channel] = []
        self._chunks = 0
        self._chunk_indexes = bytearray()  # encoded: there may be many, and each tail has them all
        header = MAGIC + serialize(Header(profile="ros2", library="trajectory_recorder"))
        self._pending: list[bytes] = [header]
        self._pending_bytes = len(header)
        self._data_end = 0  # bytes on disk that are never touched again
        self._tail = b""  # what follows them: summary, footer
        self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o644)

    @property
    def size(self) -> int:
        """Bytes written and pending, without the summary."""
        return self._data_end + self._pending_bytes

    @property
    def messages(self) -> int:
        """Messages in finished chunks."""
        return sum(self.counts.values())

    @property
    def flush_due(self) -> bool:
        """Whether enough is pending for the price of a new tail."""
        return self._pending_bytes >= max(_PENDING_BYTES, _PENDING_TAILS * len(self._tail))

    def add_channel(self, channel_id: int, topic: Topic) -> None:
        """Add the schema, when it is new, and the channel of a topic.

        Parameters
        ----------
        channel_id : int
            Id of the topic.
        topic : Topic
            The topic.
        """
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

    def add_chunk(self, chunk: list[bytes], index: Mapping[int, list[int]]) -> None:
        """Add a chunk.

        Parameters
        ----------
        chunk : list of bytes
            Pieces of its message records.
        index : mapping of int to list of int
            Stamp, offset, stamp, offset, ... of the messages, by topic id.
        """
        if len(chunk) > _BUFFERS:
            chunk = [b"".join(chunk)]
        crc = 0
        for piece in chunk:
            crc = zlib.crc32(piece, crc)
        data = self._compress(chunk)
        size, compressed_size = sum(map(len, chunk)), sum(map(len, data))
        start = min(min(entries[::2]) for entries in index.values())
        end = max(max(entries[::2]) for entries in index.values())
        name = self._compression.encode()
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
                compression=self._compression,
                compressed_size=compressed_size,
                uncompressed_size=size,
            )
        )
        self.start = min(start, self.start) if self._chunks else start
        self.end = max(end, self.end)
        self._chunks += 1

    def flush(self, metadata: Mapping[str, str]) -> None:
        """Write what is pending and a new tail behind it.

        Parameters
        ----------
        metadata : mapping of str to str
            Notes about the drive.
        """
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
        self._pending, self._pending_bytes = [], 0
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
        self._pending_bytes += len(data)

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
