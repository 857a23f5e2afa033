"""Live nodes: a domain of its own per test, discovery that takes milliseconds."""

import itertools
from collections.abc import Iterator
from pathlib import Path

import pytest
import rclpy
from rclpy.context import Context
from rclpy.node import Node

from tricycle_cli.operation import processes

_tests = itertools.count()


@pytest.fixture
def ros_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """Environment for processes that run nodes, set in this process too."""
    domain = processes.own_domain(next(_tests))
    env = processes.ros_environment(domain=domain, log_dir=tmp_path / "ros_log")
    for name, value in env.items():
        monkeypatch.setenv(name, value)
    return env


@pytest.fixture
def ros_node(ros_environment: dict[str, str]) -> Iterator[Node]:
    """A node in a context of its own, on the test's domain; the test spins it."""
    context = Context()
    rclpy.init(context=context, domain_id=int(ros_environment["ROS_DOMAIN_ID"]))
    node = rclpy.create_node("test_observer", context=context)
    yield node
    node.destroy_node()
    rclpy.shutdown(context=context)
