"""Recording of messages to bags, without ROS.

`Recording` keeps the latched messages of all topics also while nothing is recorded, so that a bag
begins with them; it opens and closes bags, watches the disk, and reports its state.
"""

import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from trajectory_recorder.backlog import Backlog, KeptMessage
from trajectory_recorder.bag.records import LOST
from trajectory_recorder.bag.topics import Topic, deserialize
from trajectory_recorder.bag.writer import BagWriter, Compression
from trajectory_recorder.topic_patterns import matches
from trajectory_recorder.topic_source import TopicSource
from tricycle_core.diagnostics import Level
from tricycle_core.documents import nearest_existing
from tricycle_core.errors import BagError

LACKS = " lacks messages that the recorder lost: "
"""Text between the path of a bag and what it lacks, in the answer of `~/stop`."""

METADATA = ("plan_id", "vehicle*", "firmware*")
"""Values of diagnostics that are copied to the bag's metadata record."""

_DIAGNOSTICS: dict[str, Callable[[Any], Any]] = {  # to a list of DiagnosticStatus
    "diagnostic_msgs/msg/DiagnosticStatus": lambda m: [m],
    "diagnostic_msgs/msg/DiagnosticArray": lambda m: m.status,
}


@dataclass(frozen=True)
class BagSettings:
    """Settings of the bags to be written.

    Attributes
    ----------
    compression : Compression
        Compression of the chunks.
    split_size : int
        Size after which the next file is begun [bytes]; 0: no limit.
    split_duration : float
        Duration after which the next file is begun [s]; 0: no limit.
    disk_reserve : float
        Space left free on the disk [bytes].
    metadata : mapping of str to str
        Entries for the metadata record of every bag.
    backlog : int
        Newest messages kept for `Recording.snapshot` while nothing is recorded [bytes].
    """

    compression: Compression = Compression.ZSTD
    split_size: int = 0
    split_duration: float = 0.0
    disk_reserve: float = 0.0
    metadata: Mapping[str, str] = field(default_factory=dict)
    backlog: int = 0


@dataclass(frozen=True)
class Status:
    """State of the recorder, for diagnostics.

    Attributes
    ----------
    level : Level
        ERROR where a recording ended by itself, WARN where messages or topics are missing.
    message : str
        State in one line.
    values : mapping of str to object
        Details by name.
    """

    level: Level
    message: str
    values: Mapping[str, object]


class Recording:
    """The topics that are received, and the bag that they are written to.

    Parameters
    ----------
    settings : BagSettings
        Settings of all bags.
    failed : callable
        Called with the reason when the disk ends a recording; the bag holds what it took.

    Attributes
    ----------
    topics : dict of str to TopicSource
        Topics that are received, by name.
    refused : dict of str to str
        Topics that are not recorded, and why.
    """

    def __init__(self, settings: BagSettings, failed: Callable[[str], None]) -> None:
        self.topics: dict[str, TopicSource] = {}
        self.refused: dict[str, str] = {}
        self._settings = settings
        self._failed = failed
        self._backlog = Backlog(settings.backlog)
        self._bag: BagWriter | None = None
        self._paused = False
        self._failure = ""  # why the last recording ended by itself
        self._reported = (0.0, 0, 0)  # s, messages, bytes
        self._disk_free = 0  # bytes

    @property
    def lost(self) -> str:
        """Return the numbers of lost messages by topic since a bag began or ended; may be empty."""
        return ", ".join(f"{s.lost} of {name}" for name, s in self.topics.items() if s.lost)

    def check_room(self, output: str) -> None:
        """Refuse a bag that would end at once, because less than the reserve is free.

        Parameters
        ----------
        output : str
            Directory of the bag.

        Raises
        ------
        BagError
            If it would; the message says how much is free.
        """
        path = Path(output).absolute()
        if scarce := self._scarce(shutil.disk_usage(nearest_existing(path)).free):
            raise BagError(f"{path}: {scarce}")

    def start(self, output: str, stamp: int | None) -> Path:
        """Begin a bag with the latched messages received so far; return where it is.

        Parameters
        ----------
        output : str
            Directory to create.
        stamp : int, optional
            Time now, of the latched messages [ns]; None: they are left to `write_latched`.

        Raises
        ------
        BagError
            If a bag is being recorded, none is named, or it exists.
        OSError
            If the disk refuses it.
        """
        bag = self._open(output)
        for source in self.topics.values():
            source.lost = 0
            if stamp is not None:
                for data in source.latched:
                    self._put(source, data, stamp)
        if self._bag is None:
            raise BagError(self._failure)
        return bag.path

    def snapshot(self, output: str) -> Path:
        """Write a bag of the newest messages received; return where it is.

        Parameters
        ----------
        output : str
            Directory to create.

        Raises
        ------
        BagError
            If none are kept, or `start` would raise it.
        OSError
            If the disk refuses it.
        """
        if not self._settings.backlog:
            raise BagError("no messages are kept: start with the parameter snapshot_size")
        kept = list(self._backlog.messages())
        if self._bag is None and not kept:
            raise BagError("no message was received")
        self._open(output)
        for message in kept:
            self._put(self.topics[message.topic], message.data, message.stamp)
        return self.stop()

    def pause(self) -> None:
        """Write no more messages, latched ones excepted, until `resume`.

        Raises
        ------
        BagError
            If nothing is being recorded.
        """
        self._recorded()
        self._paused = True

    def resume(self) -> None:
        """Write messages again.

        Raises
        ------
        BagError
            If nothing is being recorded.
        """
        self._recorded()
        self._paused = False

    def split(self, stamp: int) -> None:
        """Begin the next file of the bag.

        Parameters
        ----------
        stamp : int
            Time now, of the latched messages [ns].

        Raises
        ------
        BagError
            If nothing is being recorded.
        OSError
            If the disk refuses it.
        """
        self._recorded().split(stamp)

    def _recorded(self) -> BagWriter:
        if self._bag is None:
            raise BagError(self._failure or "not recording")
        return self._bag

    def _open(self, output: str) -> BagWriter:
        """Begin a bag with all topics, empty."""
        if self._bag is not None:
            raise BagError(f"already recording {self._bag.path}: stop it first")
        if not output:
            raise BagError("the parameter output is empty: set it to the directory of the bag")
        bag = BagWriter(
            Path(output).absolute(),
            compression=self._settings.compression,
            split_size=self._settings.split_size,
            split_duration=self._settings.split_duration,
            metadata=self._settings.metadata,
        )
        self._bag = bag
        self._backlog.clear()
        self._paused = False
        self._failure = ""
        self._reported = (time.monotonic(), 0, 0)
        self._disk_free = shutil.disk_usage(bag.path).free
        for source in self.topics.values():
            source.id = bag.add_topic(source.topic)
        return bag

    def stop(self) -> Path:
        """Close the bag; return where it is.

        Raises
        ------
        BagError
            If nothing is being recorded.
        OSError
            If the disk does not take the rest.
        """
        bag = self._recorded()
        self._bag = None
        self._note_lost(bag)
        try:
            bag.close()
        except OSError as error:
            bag.fail(f"{bag.path}: {error.strerror or error}")
            raise
        for source in self.topics.values():
            source.lost = 0
        return bag.path

    def _note_lost(self, bag: BagWriter) -> None:
        if self.lost:
            bag.metadata[LOST] = self.lost

    def forget_other_type(self, topic: Topic) -> bool:
        """Forget a topic that had another type before; return whether there was one.

        Parameters
        ----------
        topic : Topic
            Topic as it is offered now.

        Raises
        ------
        BagError
            If the bag being recorded has it with the other type.
        """
        source = self.topics.get(topic.name)
        if source is None or source.topic.type == topic.type:
            return False
        if self._bag is not None:
            raise BagError(f"has the type {topic.type}, and {source.topic.type} in this bag")
        del self.topics[topic.name]
        self._backlog.forget(topic.name)
        return True

    def offer(self, topic: Topic) -> TopicSource:
        """Add a topic, or note that it is offered differently."""
        source = self.topics.get(topic.name)
        if source is not None:
            source.offered(topic)
            if self._bag is not None:
                self._bag.offered(source.id, topic)
            return source
        source = self.topics[topic.name] = TopicSource(topic)
        if self._bag is not None:
            source.id = self._bag.add_topic(topic)
        return source

    def write(self, source: TopicSource, data: bytes, stamp: int) -> None:
        """Write a message where a bag is being recorded, or keep it for `snapshot`.

        Parameters
        ----------
        source : TopicSource
            One of `topics`.
        data : bytes
            Serialised message.
        stamp : int
            Time of receipt [ns].
        """
        latched = source.latched.maxlen or 0
        if self._bag is None:
            self._backlog.add(KeptMessage(source.topic.name, stamp, data, latched))
            return
        if latched:
            self._backlog.latch(KeptMessage(source.topic.name, stamp, data, latched))
        elif self._paused:
            return
        self._put(source, data, stamp)

    def _put(self, source: TopicSource, data: bytes, stamp: int) -> None:
        """Write a message to the bag, unless the disk has ended it."""
        if self._bag is None:
            return
        try:
            self._bag.write(source.id, stamp, data)
        except OSError as error:
            self._fail(f"{self._bag.path}: {error.strerror or error}")
            return
        statuses = _DIAGNOSTICS.get(source.topic.type)
        if statuses is not None:
            with suppress(BagError):  # a message of no such type is recorded all the same
                for status in statuses(deserialize(source.topic.type, data)):
                    pairs = ((pair.key, pair.value) for pair in status.values)
                    self._bag.metadata |= {k: v for k, v in pairs if matches(k, METADATA)}

    def write_latched(self, stamp: int) -> None:
        """Write the latched messages that came before there was a time.

        Parameters
        ----------
        stamp : int
            Time of the first tick of the clock [ns].
        """
        for source in self.topics.values():
            for data in source.latched:
                self.write(source, data, stamp)

    def flush(self) -> None:
        """Bring to the disk what was written, or end the recording where the disk is full."""
        if self._bag is None:
            return
        try:
            self._disk_free = shutil.disk_usage(self._bag.path).free
            reason = self._scarce(self._disk_free)
            if not reason:
                self._note_lost(self._bag)  # a killed recorder says it, too
                self._bag.flush()
                return
        except OSError as error:
            reason = f"{self._bag.path}: {error.strerror or error}"
        self._fail(reason)

    def _scarce(self, free: int) -> str:
        """Return by how much the free space is below the reserve; empty if there is enough."""
        reserve = self._settings.disk_reserve
        if free >= reserve:
            return ""
        return f"{free / 1e6:.0f} MB of disk left, disk_reserve is {reserve / 1e6:.0f} MB"

    def status(self, patterns: Sequence[str]) -> Status:
        """Return how the recorder is; rates are those since the call before.

        Parameters
        ----------
        patterns : sequence of str
            Patterns of the topics to record; those without a topic are named.
        """
        values: dict[str, object] = {}
        if self._bag is not None:
            before, messages, size = self._reported
            now = time.monotonic()
            self._reported = (now, self._bag.messages, self._bag.size)
            values = {
                "bag": self._bag.path,
                "messages": self._bag.messages,
                "bytes": self._bag.size,
                "messages_per_second": round((self._bag.messages - messages) / (now - before), 1),
                "bytes_per_second": round((self._bag.size - size) / (now - before)),
                "disk_free": self._disk_free,
            }
        lost = sum(source.lost for source in self.topics.values())
        values["lost"] = lost
        values["topics"] = " ".join(sorted(self.topics))
        missing = [p for p in patterns if not any(matches(name, [p]) for name in self.topics)]
        if missing:
            values["missing"] = " ".join(missing)
        values |= self.refused
        if self._failure:
            return Status(Level.ERROR, self._failure, values)
        if self._bag is not None and self._paused:
            return Status(Level.WARN, "paused", values | {"paused": True})
        if lost:
            return Status(Level.WARN, f"{lost} messages lost", values)
        if self.refused:
            return Status(Level.WARN, "topics are not recorded", values)
        return Status(Level.OK, "recording" if self._bag else "not recording", values)

    def _fail(self, reason: str) -> None:
        bag, self._bag = self._bag, None
        self._failure = f"recording stopped: {reason}"
        if bag is not None:
            self._note_lost(bag)
            bag.fail(reason)
        self._failed(self._failure)
