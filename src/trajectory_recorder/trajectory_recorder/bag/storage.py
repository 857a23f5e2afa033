"""What a bag's files have in common, of whichever format they are."""

from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import NamedTuple, Protocol

from trajectory_recorder.bag.topics import Topic
from tricycle_core.errors import BagError

Damaged = Callable[[BagError], None]
"""Called with each part of a bag that cannot be read: `BagReader` lists them."""


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
    published : int, optional
        Time of its publication [ns], where that was recorded too.
    """

    topic: str
    stamp: int
    data: bytes
    published: int | None = None


class Block(NamedTuple):
    """Messages that are read together."""

    start: int  # ns, no stamp is smaller
    messages: Iterator[RecordedMessage]
    ordered: bool = False  # by stamp


class Storage(Protocol):
    """One file of a bag (or, for foreign formats, all of it)."""

    complete: bool
    metadata: dict[str, str]
    attachments: int  # files in it, as MCAP may have

    @property
    def kind(self) -> str:
        """Storage format: "mcap" or "sqlite3"."""

    @property
    def files(self) -> list[Path]:
        """Files that hold the messages."""

    @property
    def size(self) -> int:
        """Size of these files [bytes]."""

    @property
    def fetched(self) -> int:
        """Number of bytes that came from elsewhere."""

    @property
    def span(self) -> tuple[int, int] | None:
        """Smallest and largest stamp [ns]; None without messages."""

    @property
    def topics(self) -> list[Topic]:
        """Topics with the number of their messages."""

    def messages(self, topics: Collection[str]) -> Iterator[RecordedMessage]:
        """Yield the messages of topics in the order of the file.

        Parameters
        ----------
        topics : collection of str
            Names of the topics.
        """

    def blocks(self, topics: Collection[str]) -> Iterator[Block]:
        """Yield blocks that hold the messages of topics.

        Parameters
        ----------
        topics : collection of str
            Names of the topics.
        """

    def close(self) -> None:
        """Close the file."""
