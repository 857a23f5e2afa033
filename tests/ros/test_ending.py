"""Nodes end when they are told to, however often."""

import subprocess
import sys

import pytest

pytestmark = pytest.mark.ros

NODE = """
import signal
import sys

from rclpy.node import Node
from tricycle_core.nodes import run_node

left = 100


def again(*_):
    global left
    if not left:
        sys.setprofile(None)
        return
    left -= 1
    signal.raise_signal(signal.SIGTERM)


class Told(Node):
    def __init__(self):
        super().__init__("told")
        self.create_timer(0.01, self.tell)

    def tell(self):
        sys.setprofile(again)  # another signal at each step of the first one's handler
        signal.raise_signal(signal.SIGTERM)


run_node(Told)
assert not left
"""


def test_signals_that_interrupt_each_other_end_a_node(ros_environment):
    ended = subprocess.run([sys.executable, "-c", NODE], env=ros_environment, timeout=60)
    assert ended.returncode == 0
