"""Messages from a time on, with what a late subscriber is given of earlier ones."""

from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from itertools import chain

from trajectory_recorder.bag.storage import RecordedMessage
from trajectory_recorder.bag.topics import Topic

TRANSFORMS = "tf2_msgs/msg/TFMessage"


def since(
    begin: int, messages: Iterable[RecordedMessage], topics: Mapping[str, Topic]
) -> Iterator[RecordedMessage]:
    """Yield the messages from a time on, and before them the newest earlier ones of latched topics.

    They are as many as the publishers keep; of static transforms all, as each tells other frames.

    Parameters
    ----------
    begin : int
        Least stamp [ns].
    messages : iterable of RecordedMessage
        In the order of their stamps.
    topics : mapping of str to Topic
        Topics of the messages, by name.
    """
    earlier: dict[str, deque[RecordedMessage]] = {}
    for message in messages:
        if message.stamp >= begin:
            yield from _by_stamp(earlier)
            earlier.clear()
            yield message
        elif (topic := topics[message.topic]).latched:
            depth = None if topic.type == TRANSFORMS else topic.latched_depth
            earlier.setdefault(message.topic, deque(maxlen=depth)).append(message)
    yield from _by_stamp(earlier)


def _by_stamp(messages: Mapping[str, Iterable[RecordedMessage]]) -> list[RecordedMessage]:
    return sorted(chain.from_iterable(messages.values()), key=lambda message: message.stamp)
