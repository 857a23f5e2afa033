"""Bags of the formats that `rosbags` reads: sqlite3, and compressed files of rosbag2."""

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, cast

from trajectory_recorder.bag.storage import Block, RecordedMessage
from trajectory_recorder.bag.topics import OfferedQos, Topic
from tricycle_core.errors import BagError, message_of

if TYPE_CHECKING:
    from rosbags.interfaces import Connection, ConnectionExtRosbag2


class RosbagsStorage:
    """A bag of a format that `rosbags` reads.

    Parameters
    ----------
    path : Path
        Path of the bag.
    files : list of Path
        Files that hold its messages.
    """

    complete = True
    attachments = 0
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
            # the end is the ns behind the last stamp
            self.span = (self._reader.start_time, self._reader.end_time - 1) if found else None
        except Exception as error:  # what is damaged comes up as an error of any kind
            raise BagError(f"{path}: {message_of(error)}") from error

    def messages(self, topics: Collection[str]) -> Iterator[RecordedMessage]:
        """Yield the messages of topics in the order of the file.

        Parameters
        ----------
        topics : collection of str
            Names of the topics.
        """
        connections = [c for c in self._reader.connections if c.topic in topics]
        if not connections:  # which would mean all to rosbags
            return
        try:
            for connection, stamp, data in self._reader.messages(connections):
                yield RecordedMessage(connection.topic, stamp, bytes(memoryview(data)))
        except Exception as error:
            raise BagError(f"{self.path}: {message_of(error)}") from error

    def blocks(self, topics: Collection[str]) -> Iterator[Block]:
        """Yield blocks that hold the messages of topics.

        Parameters
        ----------
        topics : collection of str
            Names of the topics.
        """
        yield Block(0, self.messages(topics), ordered=True)

    def close(self) -> None:
        """Close the file."""
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
