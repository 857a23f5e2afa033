"""MCAP files, read through their indexes, and up to the tear where a recorder was killed.

Wanted messages among many others cost no more than their chunks, here or behind a URL.
"""

import os
import struct
import zlib
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Footer, Metadata, MetadataIndex, Schema, Statistics

from trajectory_recorder.bag.records import (
    CHUNK,
    FOOTER_SIZE,
    INDEX_ENTRY,
    MAGIC,
    MESSAGE,
    MESSAGE_INDEX,
    METADATA_RECORD,
    RECORD,
    Buffer,
    split_records,
    stream,
)
from trajectory_recorder.bag.remote import RemoteFile
from trajectory_recorder.bag.storage import Block, Damaged, RecordedMessage
from trajectory_recorder.bag.topics import Topic, parse_profiles
from tricycle_core.errors import BagError

_DAMAGED = (
    *(struct.error, ValueError, RuntimeError, MemoryError, OverflowError),
    *(zstandard.ZstdError, McapError, OSError),
)

_TAKEN = (Opcode.CHUNK, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)
_ENDS = {Opcode.DATA_END: 4, Opcode.FOOTER: 20}  # what ends the data, with its length [bytes]
_RESERVED = set(range(0x80)) - {int(opcode) for opcode in Opcode}  # beyond: of other programs

_RUN = 4 * 2**20  # bytes of wanted chunks, one behind the other, that are fetched together

# channel, stamp and time of publication of a message, start and end of its data
_Found = tuple[int, int, int, int, int]

MAX_CHUNK = 1_000_000_000  # bytes of an uncompressed chunk; recorders write a few million


@dataclass(frozen=True)
class _Chunk:
    """A chunk record, or a run of message records that are in no chunk (``indexes`` empty)."""

    offset: int  # of the record in the file
    length: int
    start: int  # ns, smallest stamp
    end: int
    plain: bool = False  # a run of message records
    indexes: dict[int, int] = field(default_factory=dict)  # channel -> offset of its MessageIndex
    indexes_length: int = 0  # bytes behind the record

    @property
    def end_in_file(self) -> int:
        """Offset behind the record and its indexes [bytes]."""
        return self.offset + self.length + self.indexes_length

    @property
    def indexed(self) -> int:
        """Number of messages that its indexes list."""
        return (self.indexes_length - len(self.indexes) * MESSAGE_INDEX.size) // INDEX_ENTRY.size


class LocalFile:
    """A file of this computer.

    Parameters
    ----------
    path : Path
        Path of the file.
    """

    fetched = 0  # bytes from elsewhere

    def __init__(self, path: Path) -> None:
        self._path = path
        self._fd = os.open(path, os.O_RDONLY)
        self.size = os.fstat(self._fd).st_size

    def read(self, start: int, size: int) -> bytes:
        """Return bytes of the file; fewer at its end.

        Parameters
        ----------
        start, size : int
            Offset and number of the bytes.

        Raises
        ------
        OSError
            If the disk fails; it names the file.
        """
        size = min(size, self.size - start)
        if size <= 0:
            return b""
        try:
            data = os.pread(self._fd, size, start)
            while len(data) < size:
                more = os.pread(self._fd, size - len(data), start + len(data))
                if not more:
                    break
                data += more
        except OSError as error:
            raise OSError(error.errno, error.strerror, str(self._path)) from error
        return data

    def expect(self, start: int, end: int) -> None:
        """Do nothing: the operating system reads ahead.

        Parameters
        ----------
        start, end : int
            Offsets of the range that is read next.
        """

    def check_unchanged(self) -> None:
        """Do nothing: a recorder may still add to it."""

    def close(self) -> None:
        """Close the file."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


class McapFile:
    """An MCAP file, with or without its end.

    Parameters
    ----------
    path : Path
        Path or URL of the file, for messages.
    source : LocalFile or RemoteFile
        Source of the bytes of the file.
    damaged : callable or None
        As of `BagReader`.
    part : bool
        Whether it is one of several files of a bag: one that is no MCAP file is damage then.
    """

    kind = "mcap"

    def __init__(
        self,
        path: Path,
        source: LocalFile | RemoteFile,
        damaged: Damaged | None,
        *,
        part: bool = False,
    ) -> None:
        self.path = path
        self._source = source
        self._read = source.read
        self.metadata: dict[str, str] = {}
        self.attachments = 0
        self._damaged = damaged
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._counts: Counter[int] = Counter()
        self._chunks: list[_Chunk] = []
        self.size = source.size
        self.complete = False
        try:
            if not self._is_mcap(part):
                return
            footer = None
            try:
                footer = self._read_footer()
                self.complete = footer is not None and self._read_summary(footer)
            except BagError:  # a server that fails is no damage
                raise
            except _DAMAGED:
                self.complete = False
            if not self.complete:
                self.complete = self._scan() and footer is not None
                self.complete &= self._channels_are_known()
        except BaseException:
            self.close()
            raise

    @property
    def files(self) -> list[Path]:
        """Files that hold the messages."""
        return [self.path]

    @property
    def fetched(self) -> int:
        """Number of bytes that came from elsewhere."""
        return self._source.fetched

    @property
    def span(self) -> tuple[int, int] | None:
        """Smallest and largest stamp [ns]; None without messages."""
        if not self._chunks:
            return None
        return min(c.start for c in self._chunks), max(c.end for c in self._chunks)

    @property
    def topics(self) -> list[Topic]:
        """Topics with the number of their messages."""
        topics = []
        for channel in self._channels.values():
            schema = self._schemas.get(channel.schema_id)
            topics.append(
                Topic(
                    name=channel.topic,
                    type=schema.name if schema else "",
                    definition=schema.data.decode(errors="surrogateescape") if schema else "",
                    type_hash=channel.metadata.get("topic_type_hash", ""),
                    qos=parse_profiles(channel.metadata.get("offered_qos_profiles", "")),
                    count=self._counts[channel.id],
                    encoding=channel.message_encoding,
                    definition_encoding=schema.encoding if schema and schema.data else "ros2msg",
                )
            )
        return topics

    def messages(self, topics: Collection[str]) -> Iterator[RecordedMessage]:
        """Yield the messages of topics in the order of the file.

        Parameters
        ----------
        topics : collection of str
            Names of the topics.
        """
        for block in self.blocks(topics):
            yield from block.messages

    def blocks(self, topics: Collection[str]) -> Iterator[Block]:
        """Yield blocks that hold the messages of topics.

        Parameters
        ----------
        topics : collection of str
            Names of the topics.
        """
        names = {c.id: c.topic for c in self._channels.values() if c.topic in topics}
        wanted = [
            c for c in self._chunks if not c.indexes or not names.keys().isdisjoint(c.indexes)
        ]
        for chunk, run in zip(wanted, _runs(wanted), strict=True):
            messages = self._in_chunk(chunk, run, names)
            if chunk is wanted[-1]:
                messages = self._and_unchanged(messages)
            yield Block(chunk.start, messages)

    def _and_unchanged(self, messages: Iterator[RecordedMessage]) -> Iterator[RecordedMessage]:
        """The last messages that are read; an error if they may be those of another file."""
        yield from messages
        self._source.check_unchanged()

    def _in_chunk(
        self, chunk: _Chunk, run: tuple[int, int], names: Mapping[int, str]
    ) -> Iterator[RecordedMessage]:
        indexes = [offset for id_, offset in chunk.indexes.items() if id_ in names]
        self._source.expect(*run)
        try:
            record = self._read(chunk.offset, chunk.length)
            data = record if chunk.plain else _uncompress(record)
            # what recovers does without the indexes, which may be damaged too
            indexed = indexes and self._damaged is None
            found = self._indexed(data, indexes) if indexed else _messages(data)
        except BagError:
            raise
        except _DAMAGED as error:
            self._source.check_unchanged()
            failure = self._failure(chunk.offset, error)
            if self._damaged is None:
                raise failure from error
            self._damaged(failure)
            return
        for channel_id, stamp, published, start, end in found:
            if channel_id in names:
                content = bytes(data[start:end])
                # a time that was not recorded is written as the stamp
                known = None if published == stamp else published
                yield RecordedMessage(names[channel_id], stamp, content, known)

    def _failure(self, offset: int, error: Exception) -> BagError:
        why = error.strerror if isinstance(error, OSError) else error
        return BagError(f"{self.path}: damaged at byte {offset}: {why}")

    def close(self) -> None:
        """Close the file."""
        self._source.close()

    def _is_mcap(self, part: bool) -> bool:
        """Whether it begins as an MCAP file; an error or damage where it does not."""
        if self._read(0, len(MAGIC)) == MAGIC:
            return True
        what = "is empty" if self.size == 0 else "is not an MCAP file"
        error = BagError(f"{self.path} {what}")
        if part and self._damaged is not None:
            self._damaged(error)
        elif not part or self.size >= len(MAGIC):  # otherwise killed when it began this part
            raise error
        return False

    def _indexed(self, data: Buffer, indexes: list[int]) -> list[_Found]:
        """Messages of a chunk, as `_messages`, that MessageIndex records list."""
        entries: list[tuple[int, int]] = []  # offset, stamp
        for index in indexes:
            head = self._read(index, MESSAGE_INDEX.size)
            opcode, length, _, size = MESSAGE_INDEX.unpack(head)
            if opcode != Opcode.MESSAGE_INDEX or length != MESSAGE_INDEX.size - RECORD.size + size:
                raise ValueError("its message index is wrong")
            pairs = self._read(index + MESSAGE_INDEX.size, size)
            entries += ((offset, stamp) for stamp, offset in INDEX_ENTRY.iter_unpack(pairs))
        found = []
        for offset, stamp in sorted(entries):
            opcode, length = RECORD.unpack_from(data, offset)
            start = offset + RECORD.size
            channel_id, _, log_time, published = MESSAGE.unpack_from(data, start)
            if opcode != Opcode.MESSAGE or log_time != stamp or start + length > len(data):
                raise ValueError("its message index is wrong")
            found.append((channel_id, stamp, published, start + MESSAGE.size, start + length))
        return found

    def _read_footer(self) -> Footer | None:
        """Footer of a file that was finished."""
        start = self.size - FOOTER_SIZE
        if start < len(MAGIC) or self._read(self.size - len(MAGIC), len(MAGIC)) != MAGIC:
            return None
        footer: Footer = Footer.read(stream(self._read(start + RECORD.size, 20)))
        return footer

    def _read_summary(self, footer: Footer) -> bool:
        """Take channels and chunks from the summary; False if there is no complete one.

        Raises
        ------
        One of _DAMAGED
            If what is called the summary is none.
        """
        end = self.size - FOOTER_SIZE
        if not len(MAGIC) <= footer.summary_start < end:
            return False
        summary = self._read(footer.summary_start, end - footer.summary_start)
        signed = summary + self._read(end, RECORD.size + 16)
        if footer.summary_crc and zlib.crc32(signed) != footer.summary_crc:
            return False
        statistics = None
        for opcode, start, length in split_records(summary):
            content = stream(summary[start : start + length])
            if opcode == Opcode.CHUNK_INDEX:
                index = ChunkIndex.read(content)
                self._chunks.append(
                    _Chunk(
                        index.chunk_start_offset,
                        index.chunk_length,
                        index.message_start_time,
                        index.message_end_time,
                        indexes=index.message_index_offsets,
                        indexes_length=index.message_index_length,
                    )
                )
            elif opcode == Opcode.STATISTICS:
                statistics = Statistics.read(content)
            elif opcode == Opcode.METADATA_INDEX:
                metadata = MetadataIndex.read(content)
                if metadata.name == METADATA_RECORD:
                    record = self._read(metadata.offset + RECORD.size, metadata.length)
                    self.metadata = Metadata.read(stream(record)).metadata
            else:
                self._take_channel(opcode, content)
        if statistics is None:
            return False
        # messages beside the chunks, chunks whose messages no index lists, or counts that are
        # "not available": all of them are found by reading everything
        indexed = sum(chunk.indexed for chunk in self._chunks)
        counted = sum(statistics.channel_message_counts.values())
        if not indexed == counted == statistics.message_count:
            return False
        if statistics.channel_count > len(self._channels) or (
            statistics.schema_count > len(self._schemas)
        ):  # a summary need not repeat them
            return False
        self._counts.update(statistics.channel_message_counts)
        self.attachments = statistics.attachment_count
        return True

    def _scan(self) -> bool:
        """Take channels and chunks from the data; whether there is no damage.

        What comes after a damaged record is taken too where damage is told, as far as its length
        shows where that is.
        """
        self._chunks.clear()
        offset, whole = len(MAGIC), True
        while offset < self.size:
            end = self.size
            try:
                head = self._read(offset, RECORD.size)
                opcode, length = RECORD.unpack(head.ljust(RECORD.size, b"\0"))
                if _ENDS.get(opcode) == length:
                    return whole
                # what begins with 0 was never written
                if opcode in (0, *_ENDS) or offset + RECORD.size + length > self.size:
                    raise ValueError(f"the last {self.size - offset} bytes are no whole records")
                end = offset + RECORD.size + length
                if opcode in _RESERVED:
                    raise ValueError(f"no record has the opcode {opcode}")
                self.attachments += opcode == Opcode.ATTACHMENT
                if opcode in _TAKEN:
                    record = self._read(offset, end - offset)
                    chunk = opcode == Opcode.CHUNK
                    self._take_records(_uncompress(record) if chunk else record)
                    if chunk:
                        first, last, *_ = CHUNK.unpack_from(record, RECORD.size)
                        self._chunks.append(_Chunk(offset, end - offset, first, last))
                    elif opcode == Opcode.MESSAGE:
                        _, _, stamp, _ = MESSAGE.unpack_from(record, RECORD.size)
                        self._chunks.append(_Chunk(offset, end - offset, stamp, stamp, plain=True))
            except BagError:
                raise
            except _DAMAGED as error:
                if self._damaged is None and isinstance(error, OSError):
                    raise
                if self._damaged is None:
                    return False
                self._damaged(self._failure(offset, error))
                whole = False
            offset = end
        return False

    def _channels_are_known(self) -> bool:
        """Whether the topics of all messages are known: of some they may be in what is lost."""
        lost = sum(n for channel, n in self._counts.items() if channel not in self._channels)
        if lost and self._damaged is not None:
            self._damaged(BagError(f"{self.path}: the topics of {lost} messages are lost"))
        return not lost

    def _take_records(self, data: Buffer) -> None:
        for opcode, start, length in split_records(data):
            if opcode == Opcode.MESSAGE:
                self._counts[int.from_bytes(data[start : start + 2], "little")] += 1
            else:
                self._take_channel(opcode, stream(data[start : start + length]))

    def _take_channel(self, opcode: int, content: ReadDataStream) -> None:
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(content)
            self._schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(content)
            self._channels[channel.id] = channel


def _runs(chunks: list[_Chunk]) -> list[tuple[int, int]]:
    """For each chunk the range of the file that is fetched for it and for its neighbours."""
    runs: list[tuple[int, int]] = []
    begin = 0  # of the present run among the chunks
    for i, chunk in enumerate(chunks):
        start = chunks[begin].offset
        last = i + 1 == len(chunks)
        if (
            last
            or chunks[i + 1].offset != chunk.end_in_file
            or (chunks[i + 1].end_in_file - start > _RUN)
        ):
            runs += [(start, chunk.end_in_file)] * (i + 1 - begin)
            begin = i + 1
    return runs


def _messages(data: Buffer) -> list[_Found]:
    """Messages in a chunk."""
    found = []
    for opcode, start, length in split_records(data):
        if opcode == Opcode.MESSAGE:
            channel_id, _, stamp, published = MESSAGE.unpack_from(data, start)
            found.append((channel_id, stamp, published, start + MESSAGE.size, start + length))
    return found


def _uncompress(record: bytes) -> Buffer:
    """Content of a chunk record, checked."""
    _, _, size, crc, name_length = CHUNK.unpack_from(record, RECORD.size)
    start = RECORD.size + CHUNK.size + name_length
    compression = record[start - name_length : start]
    data: Buffer = memoryview(record)[start + 8 :]
    if size > MAX_CHUNK:
        raise ValueError(f"a chunk of {size} bytes is beyond the limit of {MAX_CHUNK}")
    if compression == b"zstd":
        # a frame that tells its size is decompressed whole, whatever the limit
        if zstandard.frame_content_size(data) not in (-1, size):
            raise ValueError("its zstd frame has another size than the chunk")
        data = zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
    elif compression == b"lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size)
    elif compression:
        raise ValueError(f"unknown compression {compression!r}")
    if len(data) != size or (crc and zlib.crc32(data) != crc):
        raise ValueError("checksum differs")
    return data
