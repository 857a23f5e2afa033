"""A thread that takes a node's commands, beside its executor."""

import threading
import time

import pytest
from rclpy.executors import SingleThreadedExecutor
from std_msgs.msg import Float64

from tricycle_bridge.commands.command_thread import CommandThread

pytestmark = pytest.mark.ros

PATIENCE = 20.0  # s; only a failing test waits that long


class Receiver:
    """A node's subscription in the group of a command thread, and one that the executor serves."""

    def __init__(self, node):
        self.ended = threading.Event()
        self.thread = CommandThread(node, self.ended.set)
        self.taken = []  # (thread, value)
        self.by_executor = []
        self.publishers = {t: node.create_publisher(Float64, t, 10) for t in ("fast", "slow")}
        node.create_subscription(Float64, "fast", self.take, 10, callback_group=self.thread.group)
        node.create_subscription(Float64, "slow", self.by_executor.append, 10)
        self.executor = SingleThreadedExecutor(context=node.context)
        self.executor.add_node(node)

    def take(self, message):
        if message.data < 0:
            raise ValueError("a negative command")
        self.taken.append((threading.current_thread().name, message.data))

    def send_until(self, topic, value, condition):
        deadline = time.monotonic() + PATIENCE
        while not condition():
            assert time.monotonic() < deadline
            self.publishers[topic].publish(Float64(data=value))
            self.executor.spin_once(timeout_sec=0.02)


@pytest.fixture
def receiver(ros_node):
    receiver = Receiver(ros_node)
    receiver.thread.start()
    yield receiver
    receiver.thread.stop()
    receiver.executor.shutdown()


def test_it_takes_what_is_of_its_group_and_the_executor_the_rest(receiver):
    receiver.send_until("fast", 1.0, lambda: receiver.taken)
    assert set(receiver.taken) == {("commands", 1.0)}
    receiver.send_until("slow", 2.0, lambda: receiver.by_executor)
    assert {message.data for message in receiver.by_executor} == {2.0}


def test_stopping_ends_it_and_nothing_is_taken_any_more(receiver):
    receiver.send_until("fast", 1.0, lambda: receiver.taken)
    receiver.thread.stop()
    receiver.taken.clear()
    receiver.send_until("slow", 2.0, lambda: receiver.by_executor)
    assert receiver.taken == []
    assert not receiver.ended.is_set()  # its owner has asked for it


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_an_exception_in_a_callback_ends_it_which_the_owner_is_told(receiver):
    receiver.send_until("fast", -1.0, receiver.ended.is_set)
