"""Reading of bags without ROS, chunk by chunk, in memory that does not grow with the bag.

MCAP files are read here: through their message indexes, so that wanted messages among many others
cost no more than their chunks, and up to the tear where a recorder was killed. Those behind URLs
are fetched in the same way, chunk by chunk. sqlite3 bags and compressed files of rosbag2 are read
through `rosbags`.
"""

import heapq
import os
import re
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, cast

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, ChunkIndex, Footer, Metadata, MetadataIndex, Schema, Statistics

from trajectory_recorder.bag.location import bag_path, is_remote
from trajectory_recorder.bag.metadata import read_metadata
from trajectory_recorder.bag.records import (
    CHUNK,
    FAILURE,
    FOOTER_SIZE,
    INDEX_ENTRY,
    LOST,
    MAGIC,
    MESSAGE,
    MESSAGE_INDEX,
    METADATA_RECORD,
    RECORD,
    Buffer,
    split_records,
    stream,
)
from trajectory_recorder.bag.remote import RemoteFile, remote_files
from trajectory_recorder.bag.topics import OfferedQos, Topic, parse_profiles
from tricycle_core.closing import Closing
from tricycle_core.errors import BagError, message_of

if TYPE_CHECKING:
    from rosbags.interfaces import Connection, ConnectionExtRosbag2

__all__ = ["BagError", "BagReader", "RecordedMessage"]

_DAMAGED = (
    *(struct.error, ValueError, RuntimeError, MemoryError, OverflowError),
    *(zstandard.ZstdError, McapError),
)

Damaged = Callable[[BagError], None]
"""Called for each damaged chunk, and each file of a split bag that is no MCAP file."""

_TAKEN = (Opcode.CHUNK, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE)

_RUN = 4 * 2**20  # bytes of wanted chunks, one behind the other, that are fetched together

MAX_CHUNK = 1_000_000_000  # bytes of an uncompressed chunk; recorders write a few million


class RecordedMessage(NamedTuple):
    """One recorded message.

    Attributes
    ----------
    topic : str
        Name of the topic.
    stamp : int
        Time of receipt by the recorder's clock [ns].
    data : bytes
        Serialised message (CDR).
    """

    topic: str
    stamp: int
    data: bytes


class _Storage(Protocol):
    """One file of a bag (or, for foreign formats, all of it)."""

    complete: bool
    metadata: dict[str, str]

    @property
    def kind(self) -> str: ...

    @property
    def files(self) -> list[Path]: ...

    @property
    def size(self) -> int: ...

    @property
    def fetched(self) -> int: ...

    @property
    def span(self) -> tuple[int, int] | None: ...

    @property
    def topics(self) -> list[Topic]: ...

    def messages(self, topics: Collection[str]) -> Iterator[RecordedMessage]: ...

    def blocks(self, topics: Collection[str]) -> "Iterator[_Block]": ...

    def close(self) -> None: ...


class _Block(NamedTuple):
    """Messages that are read together."""

    start: int  # ns, no stamp is smaller
    messages: Iterator[RecordedMessage]
    ordered: bool = False  # by stamp


class BagReader(Closing):
    """An open bag: a rosbag2 directory, or a single ``.mcap`` or ``.db3`` file.

    Parameters
    ----------
    path : Path or str
        The bag, or its URL.
    damaged : callable, optional
        Called for each damaged chunk, and each file of a split bag that is no MCAP file, which are
        then passed over. Default: damage raises.

    Attributes
    ----------
    path : Path
        Path of the bag.
    topics : dict of str to Topic
        Topics by name; counts are those of the whole bag.
    metadata : dict of str to str
        Notes of the recorder about the drive.
    complete : bool
        False if a file was cut off, by a killed recorder for example, or is missing, the recorder
        lost messages, or the disk ended the recording; what is left is read.
    kind : str
        Storage format: "mcap", "sqlite3", ...
    files : list of Path
        Files with the messages.
    size : int
        Size of these files [bytes].
    span : (int, int) or None
        Smallest and largest stamp [ns]; None without messages.

    Raises
    ------
    BagError
        If there is no bag, it holds nothing that can be read, or it cannot be fetched.
    """

    def __init__(self, path: Path | str, *, damaged: Damaged | None = None) -> None:
        if isinstance(path, str):
            path = bag_path(path)
        self.path = path
        self.topics: dict[str, Topic] = {}
        information, files = remote_files(path) if is_remote(path) else (_information(path), [])
        # a file torn within its end holds no metadata record
        self.metadata = _texts(information.get("custom_data"))
        self.complete = True
        self._storages: list[_Storage] = []
        with ExitStack() as stack:
            for storage in (
                _open_remote(files, damaged)
                if files
                else _open_storages(path, information, damaged)
            ):
                stack.callback(storage.close)
                self._storages.append(storage)
                self.complete &= storage.complete
                self.metadata |= storage.metadata
                for topic in storage.topics:
                    known = self.topics.get(topic.name, replace(topic, count=0))
                    try:
                        known.check_same(topic)
                    except BagError as error:
                        raise BagError(f"{path}: {error}") from error
                    self.topics[topic.name] = replace(known, count=known.count + topic.count)
            if not self.topics:
                cut = "" if self.complete else ", or it was cut off before its first message"
                raise BagError(f"{path} is an empty bag: no topic was recorded{cut}")
            self.kind = self._storages[0].kind
            self.files = [file for storage in self._storages for file in storage.files]
            self.complete &= not _missing(path, information, files)
            self.complete &= self.metadata.keys().isdisjoint((LOST, FAILURE))
            self.size = sum(storage.size for storage in self._storages)
            spans = [storage.span for storage in self._storages if storage.span]
            self.span = (min(s for s, _ in spans), max(e for _, e in spans)) if spans else None
            self._closing = stack.pop_all()

    @property
    def fetched(self) -> int:
        """Bytes of the files that came from elsewhere; 0 for a bag of this computer."""
        return sum(storage.fetched for storage in self._storages)

    def messages(self, topics: Collection[str] | None = None) -> Iterator[RecordedMessage]:
        """Yield messages in the order of the file: within a topic that of recording.

        Parameters
        ----------
        topics : collection of str, optional
            Names of those wanted. Default: all.

        Raises
        ------
        BagError
            If the file is damaged where it should be whole.
        """
        wanted = self.topics.keys() if topics is None else topics
        for storage in self._storages:
            yield from storage.messages(wanted)

    def messages_by_stamp(self, topics: Collection[str] | None = None) -> Iterator[RecordedMessage]:
        """Yield messages in the order of their stamps; equal ones as they were recorded.

        A recorder writes a topic's waiting messages together, so that stamps go back within a
        file, by as much as it was behind. Only chunks that overlap in time are held in memory.

        Parameters
        ----------
        topics : collection of str, optional
            Names of those wanted. Default: all.

        Raises
        ------
        BagError
            If the file is damaged where it should be whole.
        """
        wanted = self.topics.keys() if topics is None else topics
        blocks = [block for storage in self._storages for block in storage.blocks(wanted)]
        blocks.sort(key=lambda block: block.start)
        number = count()
        waiting: list[tuple[int, int, RecordedMessage]] = []
        for i, block in enumerate(blocks):
            if block.ordered and len(blocks) == 1:
                yield from block.messages
                return
            for message in block.messages:
                heapq.heappush(waiting, (message.stamp, next(number), message))
            last = i + 1 == len(blocks)
            while waiting and (last or waiting[0][0] <= blocks[i + 1].start):
                yield heapq.heappop(waiting)[2]

    def close(self) -> None:
        """Close the files."""
        self._closing.close()


def _open_remote(files: list[Path], damaged: Damaged | None) -> Iterator[_Storage]:
    """Files of a bag elsewhere in the order of recording."""
    for file in sorted(files, key=_part_number):
        yield _McapFile(file, RemoteFile(file), damaged, part=len(files) > 1)


def _open_storages(
    path: Path, information: Mapping[str, Any], damaged: Damaged | None
) -> Iterator[_Storage]:
    """Files of a bag in the order of recording."""
    if not path.exists():
        raise BagError(f"{path}: no such bag")
    if path.is_file():
        if path.suffix == ".mcap":
            yield _McapFile(path, _LocalFile(path), damaged)
        elif path.suffix == ".db3":
            yield _RosbagsStorage(path, [path])
        else:
            raise BagError(f"{path} is not a bag: needs a rosbag2 directory, .mcap or .db3 file")
        return
    named = _named(information)
    compression = information.get("compression_mode", "")
    if information.get("storage_identifier", "mcap") != "mcap" or (
        not isinstance(compression, str) or compression.lower() not in ("", "none")
    ):
        yield _RosbagsStorage(path, [path / name for name in named])
    elif files := _parts(path, named):
        for file in files:
            yield _McapFile(file, _LocalFile(file), damaged, part=len(files) > 1)
    else:
        inside = sorted(file.parent for file in path.glob("*/metadata.yaml"))
        hint = f"; it holds bags, as {inside[0]}" if inside else ""
        raise BagError(f"{path} is not a bag: it holds no metadata.yaml and no .mcap file{hint}")


def _information(path: Path) -> dict[str, Any]:
    """Content of a bag's metadata.yaml; empty where all that is needed is in the files."""
    try:
        return read_metadata(path)
    except BagError:
        if not any(path.glob("*.mcap")):
            raise
        return {}


def _named(information: Mapping[str, Any]) -> list[str]:
    """Names of the files in a bag's metadata.yaml."""
    names = information.get("relative_file_paths")
    return [Path(str(name)).name for name in names] if isinstance(names, list) else []


def _parts(path: Path, named: list[str]) -> list[Path]:
    """MCAP files of a bag in the order of recording, without copies that lie beside them."""
    files = sorted(path.glob("*.mcap"), key=_part_number)
    newest = max((Path(name) for name in named), key=_part_number, default=None)

    def belongs(file: Path) -> bool:
        if newest is None or file.name in named:
            return True
        # a recorder that is killed when it begins a file has not named it yet
        same = file.stem.rpartition("_")[0] == newest.stem.rpartition("_")[0]
        return same and _part_number(file)[0] > _part_number(newest)[0]

    return [file for file in files if belongs(file)] or files  # all of them have other names


def _missing(path: Path, information: Mapping[str, Any], remote: list[Path]) -> set[str]:
    """Files that a bag's metadata.yaml names and that are not there."""
    if not (remote or path.is_dir()):
        return set()
    names = set(_named(information))
    there = {file.name for file in remote}
    return names - there if remote else {name for name in names if not (path / name).exists()}


def _texts(pairs: object) -> dict[str, str]:
    """Key and value pairs as text; empty for anything else."""
    return {str(k): str(v) for k, v in pairs.items()} if isinstance(pairs, dict) else {}


def _part_number(path: Path) -> tuple[int, str]:
    number = re.search(r"_(\d+)$", path.stem)
    return (int(number[1]) if number else 0, path.name)


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
        return self.offset + self.length + self.indexes_length

    @property
    def indexed(self) -> int:
        """Number of messages that its indexes list."""
        return (self.indexes_length - len(self.indexes) * MESSAGE_INDEX.size) // INDEX_ENTRY.size


class _LocalFile:
    """A file of this computer."""

    fetched = 0  # bytes from elsewhere

    def __init__(self, path: Path) -> None:
        self._fd = os.open(path, os.O_RDONLY)
        self.size = os.fstat(self._fd).st_size

    def read(self, start: int, size: int) -> bytes:
        size = min(size, self.size - start)
        if size <= 0:
            return b""
        data = os.pread(self._fd, size, start)
        while len(data) < size:
            more = os.pread(self._fd, size - len(data), start + len(data))
            if not more:
                break
            data += more
        return data

    def expect(self, start: int, end: int) -> None:
        """Do nothing: the operating system reads ahead."""

    def close(self) -> None:
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


class _McapFile:
    """An MCAP file, with or without its end."""

    kind = "mcap"

    def __init__(
        self,
        path: Path,
        source: _LocalFile | RemoteFile,
        damaged: Damaged | None,
        *,
        part: bool = False,
    ) -> None:
        self.path = path
        self._source = source
        self._read = source.read
        self.metadata: dict[str, str] = {}
        self._damaged = damaged
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, Channel] = {}
        self._counts: Counter[int] = Counter()
        self._chunks: list[_Chunk] = []
        self.size = source.size
        self.complete = False
        try:
            if part and self.size < len(MAGIC):  # killed when it began this part
                return
            try:
                self._check_magic()
            except BagError as error:
                if not part or damaged is None:
                    raise
                damaged(error)
                return
            footer = self._read_footer()
            try:
                self.complete = footer is not None and self._read_summary(footer)
            except _DAMAGED:
                self.complete = False
            if not self.complete:
                self.complete = self._scan() and footer is not None
        except BaseException:
            self.close()
            raise

    @property
    def files(self) -> list[Path]:
        return [self.path]

    @property
    def fetched(self) -> int:
        return self._source.fetched

    @property
    def span(self) -> tuple[int, int] | None:
        if not self._chunks:
            return None
        return min(c.start for c in self._chunks), max(c.end for c in self._chunks)

    @property
    def topics(self) -> list[Topic]:
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
        for block in self.blocks(topics):
            yield from block.messages

    def blocks(self, topics: Collection[str]) -> Iterator[_Block]:
        names = {c.id: c.topic for c in self._channels.values() if c.topic in topics}
        wanted = [
            c for c in self._chunks if not c.indexes or not names.keys().isdisjoint(c.indexes)
        ]
        for chunk, run in zip(wanted, _runs(wanted), strict=True):
            indexes = [offset for id_, offset in chunk.indexes.items() if id_ in names]
            yield _Block(chunk.start, self._in_chunk(chunk, run, indexes, names))

    def _in_chunk(
        self, chunk: _Chunk, run: tuple[int, int], indexes: list[int], names: Mapping[int, str]
    ) -> Iterator[RecordedMessage]:
        self._source.expect(*run)
        try:
            record = self._read(chunk.offset, chunk.length)
            data = record if chunk.plain else _uncompress(record)
            # what recovers does without the indexes, which may be damaged too
            indexed = indexes and self._damaged is None
            found = self._indexed(data, indexes) if indexed else _messages(data)
        except _DAMAGED as error:
            failure = self._failure(chunk.offset, error)
            if self._damaged is None:
                raise failure from error
            self._damaged(failure)
            return
        for channel_id, stamp, start, end in found:
            if channel_id in names:
                yield RecordedMessage(names[channel_id], stamp, bytes(data[start:end]))

    def _failure(self, offset: int, error: Exception) -> BagError:
        return BagError(f"{self.path}: damaged chunk at byte {offset}: {error}")

    def close(self) -> None:
        self._source.close()

    def _check_magic(self) -> None:
        if self._read(0, len(MAGIC)) != MAGIC:
            what = "is empty" if self.size == 0 else "is not an MCAP file"
            raise BagError(f"{self.path} {what}")

    def _indexed(self, data: Buffer, indexes: list[int]) -> list[tuple[int, int, int, int]]:
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
            channel_id, _, log_time, _ = MESSAGE.unpack_from(data, start)
            if opcode != Opcode.MESSAGE or log_time != stamp or start + length > len(data):
                raise ValueError("its message index is wrong")
            found.append((channel_id, stamp, start + MESSAGE.size, start + length))
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
        return True

    def _scan(self) -> bool:
        """Take channels and chunks from the data; whether there is no damage.

        What comes after a damaged record is taken too where damage is told.
        """
        self._chunks.clear()
        offset, whole = len(MAGIC), True
        while offset < self.size:
            head = self._read(offset, RECORD.size)
            if len(head) < RECORD.size:
                return False
            opcode, length = RECORD.unpack(head)
            end = offset + RECORD.size + length
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                return whole
            if opcode == 0 or end > self.size:  # no record begins with zero: it was never written
                return False
            try:
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
            except _DAMAGED as error:
                if self._damaged is None:
                    return False
                self._damaged(self._failure(offset, error))
                whole = False
            offset = end
        return False

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


class _RosbagsStorage:
    """A bag of a format that `rosbags` reads."""

    complete = True
    fetched = 0

    def __init__(self, path: Path, files: list[Path]) -> None:
        from rosbags.rosbag2 import Reader  # takes a while, and few bags need it

        self.path = path
        self.metadata: dict[str, str] = {}
        self.files = files
        databases = any(".db3" in file.suffixes for file in self.files)
        self.kind = "sqlite3" if databases else "mcap"
        try:
            self._reader = Reader(path)
            self._reader.open()
            self.size = sum(file.stat().st_size for file in files)
            self.topics = [_rosbags_topic(c) for c in self._reader.connections]
            found = self._reader.message_count > 0
            self.span = (self._reader.start_time, self._reader.end_time) if found else None
        except Exception as error:  # what is damaged comes up as an error of any kind
            raise BagError(f"{path}: {message_of(error)}") from error

    def messages(self, topics: Collection[str]) -> Iterator[RecordedMessage]:
        connections = [c for c in self._reader.connections if c.topic in topics]
        if not connections:  # which would mean all to rosbags
            return
        try:
            for connection, stamp, data in self._reader.messages(connections):
                yield RecordedMessage(connection.topic, stamp, bytes(memoryview(data)))
        except Exception as error:
            raise BagError(f"{self.path}: {message_of(error)}") from error

    def blocks(self, topics: Collection[str]) -> Iterator[_Block]:
        yield _Block(0, self.messages(topics), ordered=True)

    def close(self) -> None:
        self._reader.close()


def _rosbags_topic(connection: "Connection") -> Topic:
    texts = (connection.topic, connection.msgtype, connection.digest)
    if not isinstance(connection.msgcount, int) or not all(isinstance(t, str) for t in texts):
        raise BagError("its topics need a name, a type and a message count")
    ext = cast("ConnectionExtRosbag2", connection.ext)
    return Topic(
        name=connection.topic,
        type=connection.msgtype,
        definition=connection.msgdef.data,
        type_hash=connection.digest,
        qos=tuple(map(OfferedQos.of_connection, ext.offered_qos_profiles)),
        count=connection.msgcount,
        encoding=ext.serialization_format,
        definition_encoding="ros2idl" if connection.msgdef.format.name == "IDL" else "ros2msg",
    )


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


def _messages(data: Buffer) -> list[tuple[int, int, int, int]]:
    """Channel, stamp, start and end of the data of each message in a chunk."""
    found = []
    for opcode, start, length in split_records(data):
        if opcode == Opcode.MESSAGE:
            channel_id, _, stamp, _ = MESSAGE.unpack_from(data, start)
            found.append((channel_id, stamp, start + MESSAGE.size, start + length))
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
