"""A thread that takes commands from their subscriptions, beside the node's executor.

For each message the executor builds a wait set of everything its node has, parameter services and
event handlers included: at a hundred commands per second that would be most of the CPU time of the
bridge. This thread waits for its few subscriptions only.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack

from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.subscription import Subscription

from tricycle_core.nodes import NotTheExecutors

_WAIT = 100_000_000  # ns after which the thread checks whether it is to end
_EVENTS = 0.5  # s between looks at the subscriptions' events, of which there are four for each


class CommandThread:
    """Calls the callbacks of those subscriptions of a node that are in one callback group.

    Parameters
    ----------
    node : rclpy.node.Node
        Node with the subscriptions.
    ended : callable
        Called in the thread when an exception in a callback ends it.

    Attributes
    ----------
    group : rclpy.callback_groups.CallbackGroup
        Group of the subscriptions; those created before `start` are served.
    """

    def __init__(self, node: Node, ended: Callable[[], None] = lambda: None) -> None:
        self.group = NotTheExecutors()
        self._ended = ended
        self._node = node
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name="commands", daemon=True)

    def start(self) -> None:
        """Begin to take messages."""
        self._thread.start()

    def stop(self) -> None:
        """End the thread; to be called before the node is destroyed."""
        self._stopping = True
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        try:
            self._serve()
        finally:
            if not self._stopping:
                self._ended()

    def _serve(self) -> None:
        node, group = self._node, self.group
        subscriptions = [s for s in node.subscriptions if s.callback_group is group]
        events = [w for w in node.waitables if w.callback_group is group]
        context = node.context.handle
        handles = [s.handle for s in subscriptions]
        by_pointer = {s.handle.pointer: s for s in subscriptions}
        with ExitStack() as in_use:
            for entity in (context, *handles, *events):
                in_use.enter_context(entity)
            n = len(subscriptions)
            waiting = rclpy_implementation.WaitSet(n, 0, 0, 0, 0, len(events), context)
            looked = -math.inf
            while not self._stopping:
                look = time.monotonic() - looked >= _EVENTS
                waiting.clear_entities()
                for handle in handles:
                    waiting.add_subscription(handle)
                if look:
                    looked = time.monotonic()
                    for event in events:
                        event.add_to_wait_set(waiting)
                waiting.wait(_WAIT)
                for pointer in waiting.get_ready_entities("subscription"):
                    self._take(by_pointer[pointer])
                for event in events if look else ():
                    if event.is_ready(waiting) and (data := event.take_data()):
                        event.callback(data)

    @staticmethod
    def _take(subscription: Subscription) -> None:
        taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
        if taken is not None:
            subscription.callback(taken[0])
