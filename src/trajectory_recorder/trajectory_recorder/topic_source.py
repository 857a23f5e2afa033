"""A topic that a recorder receives."""

from collections import deque

from trajectory_recorder.bag.topics import Topic


class TopicSource:
    """A topic that is received: how it is offered, its latched messages, how many were lost.

    Parameters
    ----------
    topic : Topic
        Topic as its publishers offer it now.
    """

    def __init__(self, topic: Topic) -> None:
        self.topic = topic
        self.id = 0  # in the bag being written
        self.lost = 0  # messages
        self._publishers = 0
        self._sequence = 0  # last one received
        self.latched: deque[bytes] = deque()
        self.offered(topic)

    def offered(self, topic: Topic) -> None:
        """Take note of how the topic is offered from now on."""
        self.topic = topic
        self.left(len(topic.qos))
        # The middleware says neither how many messages a publisher latches (nearly all one), nor
        # of which publisher a message is.
        self.latched = deque(self.latched, maxlen=len(topic.qos) if topic.latched else 0)

    def left(self, publishers: int) -> None:
        """Note the remaining publishers: losses show only in the numbers of a single one.

        Parameters
        ----------
        publishers : int
            Number of publishers that remain.
        """
        self._publishers = publishers
        self._sequence = 0

    def received(self, data: bytes, sequence: int) -> None:
        """Keep a latched message, and count those that are missing before it.

        Of latched topics none is missing: they tell a state, and a publisher keeps only its newest
        for a recorder that is held up.

        Parameters
        ----------
        data : bytes
            Serialised message (CDR).
        sequence : int
            Sequence number given by its publisher.
        """
        self.latched.append(data)
        if self._publishers == 1 and not self.topic.latched and 0 < self._sequence < sequence:
            self.lost += sequence - self._sequence - 1
        self._sequence = sequence
