"""Reading of bags without ROS, chunk by chunk, in memory that does not grow with the bag.

MCAP files, also those behind URLs, are read by `mcap_file`, other formats by `rosbags_storage`.
"""

import heapq
import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

from trajectory_recorder.bag.location import bag_path, is_remote
from trajectory_recorder.bag.mcap_file import LocalFile, McapFile
from trajectory_recorder.bag.metadata import read_metadata
from trajectory_recorder.bag.records import FAILURE, LOST
from trajectory_recorder.bag.remote import RemoteFile, remote_files
from trajectory_recorder.bag.rosbags_storage import RosbagsStorage
from trajectory_recorder.bag.storage import Damaged, RecordedMessage, Storage
from trajectory_recorder.bag.topics import Topic
from tricycle_core.closing import Closing
from tricycle_core.errors import BagError

__all__ = ["NOT_WHOLE", "BagError", "BagReader", "RecordedMessage"]

NOT_WHOLE = "not whole: it was cut off, or a file or messages are missing"
"""What is said of a bag that is not `complete`."""


class BagReader(Closing):
    """An open bag: a rosbag2 directory, or a single ``.mcap`` or ``.db3`` file.

    Parameters
    ----------
    path : Path or str
        The bag, or its URL.
    damaged : callable, optional
        Called for each damaged chunk, the torn end of a file, and each file of a split bag that is
        missing or no MCAP file, which are then passed over. Default: damage raises, and a file is
        read up to its torn end.

    Attributes
    ----------
    path : Path
        Path of the bag.
    topics : dict of str to Topic
        Topics by name; counts are those of the whole bag.
    metadata : dict of str to str
        Notes of the recorder about the drive.
    attachments : int
        Number of files in it, as MCAP may have; they are not read.
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
        self._storages: list[Storage] = []
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
            for missing in sorted(_missing(path, information, files)):
                self.complete = False
                if damaged is not None:
                    damaged(BagError(f"{path}: its file {missing} is missing"))
            self.complete &= self.metadata.keys().isdisjoint((LOST, FAILURE))
            self.size = sum(storage.size for storage in self._storages)
            self.attachments = sum(storage.attachments for storage in self._storages)
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


def _open_remote(files: list[Path], damaged: Damaged | None) -> Iterator[Storage]:
    """Files of a bag elsewhere in the order of recording."""
    for file in sorted(files, key=_part_number):
        yield McapFile(file, RemoteFile(file), damaged, part=len(files) > 1)


def _open_storages(
    path: Path, information: Mapping[str, Any], damaged: Damaged | None
) -> Iterator[Storage]:
    """Files of a bag in the order of recording."""
    if not path.exists():
        raise BagError(f"{path}: no such bag")
    if path.is_file():
        if path.suffix == ".mcap":
            yield McapFile(path, LocalFile(path), damaged)
        elif path.suffix == ".db3":
            yield RosbagsStorage(path, [path])
        else:
            raise BagError(f"{path} is not a bag: needs a rosbag2 directory, .mcap or .db3 file")
        return
    named = _named(information)
    compression = information.get("compression_mode", "")
    if information.get("storage_identifier", "mcap") != "mcap" or (
        not isinstance(compression, str) or compression.lower() not in ("", "none")
    ):
        yield RosbagsStorage(path, [path / name for name in named])
    elif files := _parts(path, named):
        for file in files:
            yield McapFile(file, LocalFile(file), damaged, part=len(files) > 1)
    else:
        levels = ("*/metadata.yaml", "*/*/metadata.yaml")  # of a series, of a campaign
        inside = [file.parent for level in levels for file in sorted(path.glob(level))]
        hint = f"; it holds bags, as {inside[0]}" if inside else ""
        if databases := sorted(path.glob("*.db3")):  # of a recorder that was killed
            hint = f"; give the database itself, {databases[0]}"
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
