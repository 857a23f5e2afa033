"""Parts of bags, and several bags, written as a new one."""

import heapq
import math
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from trajectory_recorder.bag.latched import since
from trajectory_recorder.bag.location import check_apart, is_remote
from trajectory_recorder.bag.reader import BagReader, RecordedMessage
from trajectory_recorder.bag.records import LOST
from trajectory_recorder.bag.topics import Topic
from trajectory_recorder.bag.writer import BagWriter, Compression, whole_or_none
from tricycle_core.errors import BagError
from tricycle_core.quantities import Progress


def convert(
    bags: Sequence[Path],
    output: Path,
    *,
    topics: Collection[str] | None = None,
    start: float = 0.0,
    duration: float = math.inf,
    compression: Compression = Compression.ZSTD,
    split_size: int = 0,
    split_duration: float = 0.0,
    progress: Progress | None = None,
) -> int:
    """Write the messages of one or several bags to a new one, by stamp; return their number.

    The new bag has the metadata on which those bags do not differ. Parts of a bag that is not whole
    are not whole either.

    Parameters
    ----------
    bags : sequence of Path
        rosbag2 directories, ``.mcap`` or ``.db3`` files.
    output : Path
        rosbag2 directory to create, with MCAP files.
    topics : collection of str, optional
        Names of the topics to copy. Default: all.
    start : float
        Recorded time to leave out [s]; the newest messages of latched topics come at the start.
    duration : float
        Recorded time to keep [s].
    compression : Compression
        Compression of the chunks.
    split_size : int
        Size after which the next file is begun [bytes]; 0: no limit.
    split_duration : float
        Duration after which the next file is begun [s]; 0: no limit.
    progress : callable, optional
        Called with the number of messages read so far and of all.

    Raises
    ------
    BagError
        If a bag cannot be read or is given twice, the output exists or is in one of them, or
        nothing is left to write.
    """
    with ExitStack() as stack:
        readers = [stack.enter_context(BagReader(bag)) for bag in bags]
        _check_given_once(readers)
        for bag in bags:
            check_apart(output, bag)
        joined: dict[str, Topic] = {}
        for reader in readers:
            for name, topic in reader.topics.items():
                if topics is not None and name not in topics:
                    continue
                known = joined.setdefault(name, topic)
                known.check_same(topic)
                if known is not topic:
                    joined[name] = replace(known, count=known.count + topic.count)
        spans = [reader.span for reader in readers if reader.span is not None]
        if not any(topic.count for topic in joined.values()) or not spans:
            raise BagError("no message is left to write")
        begin = min(first for first, _ in spans) + round(start * 1e9)
        if begin > max(last for _, last in spans):
            raise BagError(f"no message is left to write: the bags are shorter than {start:g} s")
        new = BagWriter(
            output,
            compression=compression,
            split_size=split_size,
            split_duration=split_duration,
            metadata=common_metadata(readers),
        )
        writer = stack.enter_context(whole_or_none(new))
        ids = {name: writer.add_topic(topic) for name, topic in joined.items()}
        total = sum(topic.count for topic in joined.values())
        merged = heapq.merge(
            *(reader.messages_by_stamp(joined.keys()) for reader in readers),
            key=lambda message: message.stamp,
        )
        for message in since(begin, _counted(merged, total, progress), joined):
            if message.stamp - begin > duration * 1e9:  # a sum would lose some hundred ns
                break
            stamp = max(message.stamp, begin)
            writer.write(ids[message.topic], stamp, message.data, message.published)
        if not writer.messages:
            raise BagError("no message is left to write: none of the topics has one in that time")
        return writer.messages


def _counted(
    messages: Iterable[RecordedMessage], total: int, progress: Progress | None
) -> Iterator[RecordedMessage]:
    """Yield messages, and tell how many of all there were."""
    for done, message in enumerate(messages, start=1):
        yield message
        if progress is not None and (done % 1000 == 0 or done == total):
            progress(done, total)


def _check_given_once(readers: Sequence[BagReader]) -> None:
    """Refuse a bag that comes twice, by whatever path: its messages would be doubled."""
    given: dict[Path, Path] = {}
    for reader in readers:
        files = [file if is_remote(file) else file.resolve() for file in reader.files]
        if before := next((given[file] for file in files if file in given), None):
            also = "" if before == reader.path else f", also as {before}"
            raise BagError(f"{reader.path}: is given twice{also}; name each bag once")
        given |= dict.fromkeys(files, reader.path)


def common_metadata(readers: Sequence[BagReader]) -> dict[str, str]:
    """Return the metadata of a bag that is made of others: what their recorders agree on.

    Where one of them is not whole, they say so.

    Parameters
    ----------
    readers : sequence of BagReader
        The others, open.
    """
    found: dict[str, set[str]] = {}
    for reader in readers:
        for key, value in reader.metadata.items():
            found.setdefault(key, set()).add(value)
    metadata = {key: values.pop() for key, values in found.items() if len(values) == 1}
    if not all(reader.complete for reader in readers):
        metadata.setdefault(LOST, "parts of a bag that was not whole")
    return metadata
