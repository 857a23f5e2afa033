"""The newest messages of all topics, in memory, for a bag of what has just happened."""

from collections import deque
from collections.abc import Iterator
from typing import NamedTuple


class KeptMessage(NamedTuple):
    """A message that was received.

    Attributes
    ----------
    topic : str
        Name of the topic.
    stamp : int
        Time of receipt [ns].
    data : bytes
        Serialised message (CDR).
    latched : int
        Number of messages of its topic that late subscribers receive.
    """

    topic: str
    stamp: int
    data: bytes
    latched: int


class Backlog:
    """Keeps the newest messages, and older ones of latched topics.

    Parameters
    ----------
    size : int
        Largest size of the messages kept [bytes]; 0: none.
    """

    def __init__(self, size: int) -> None:
        self._size = size
        self._kept: deque[KeptMessage] = deque()
        self._bytes = 0
        self._before: dict[str, deque[KeptMessage]] = {}  # latched ones that are no longer kept

    def add(self, message: KeptMessage) -> None:
        """Keep a message, and drop the oldest ones beyond the size.

        Parameters
        ----------
        message : KeptMessage
            Newer than those of before.
        """
        if not self._size:
            return
        self._kept.append(message)
        self._bytes += len(message.data)
        while self._bytes > self._size:
            self._drop()

    def latch(self, message: KeptMessage) -> None:
        """Take note of a latched message that is written to a bag: it replaces those of before.

        Parameters
        ----------
        message : KeptMessage
            Newer than those of before.
        """
        if self._size:
            before = self._before.get(message.topic, ())
            self._before[message.topic] = deque([*before, message], maxlen=message.latched)

    def clear(self) -> None:
        """Drop all but the latched messages."""
        while self._kept:
            self._drop()

    def forget(self, topic: str) -> None:
        """Drop the messages of a topic.

        Parameters
        ----------
        topic : str
            Name of the topic.
        """
        self._kept = deque(message for message in self._kept if message.topic != topic)
        self._bytes = sum(len(message.data) for message in self._kept)
        self._before.pop(topic, None)

    def messages(self) -> Iterator[KeptMessage]:
        """Yield what is kept; latched ones of before come first, with the stamp of the first."""
        first = self._kept[0].stamp if self._kept else None
        for latched in self._before.values():
            yield from (m if first is None else m._replace(stamp=first) for m in latched)
        yield from self._kept

    def _drop(self) -> None:
        message = self._kept.popleft()
        self._bytes -= len(message.data)
        if message.latched:
            self.latch(message)
