"""What the operator does when the middleware loses an answer."""

import pytest
from rclpy.task import Future

from tricycle_bringup import operator_node

pytestmark = pytest.mark.ros


class Losing:
    """A client whose first answer never comes."""

    def __init__(self):
        self.asked = []

    def service_is_ready(self):
        return True

    def call_async(self, request):
        future = Future()
        if self.asked:
            future.set_result("answer")
        self.asked.append(request)
        return future


def test_a_service_is_asked_again_when_its_answer_got_lost(monkeypatch):
    monkeypatch.setattr(operator_node, "ASK_AGAIN", 0.0)
    client = Losing()

    def wait(condition):
        for _ in range(1000):
            if condition():
                return
        raise AssertionError("waited in vain")

    assert operator_node.ask(client, "request", wait) == "answer"
    assert client.asked == ["request", "request"]
