"""Live nodes: a domain of its own per test, discovery that takes milliseconds."""

import itertools
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import rclpy
from node_processes import node_processes
from rclpy.context import Context
from rclpy.node import Node

from tricycle_cli.operation import processes
from tricycle_sim.rig.emulated import EmulatedRig
from tricycle_sim.vehicle import load_vehicle

QUIET = 0.1  # s
PATIENCE = 30.0  # s for nodes to end after their test
# processes that share the tests count on from one process's domain in turns, so that two of them
# never have the same one
_processes = int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "1"))
_pid = os.getppid() if _processes > 1 else os.getpid()
_tests = itertools.count(int(os.environ.get("PYTEST_XDIST_WORKER", "gw0")[2:]), _processes)


@pytest.fixture(scope="session", autouse=True)
def _compiled_vehicle_model() -> None:
    """Compile it before a test with nodes begins to wait for its simulation."""
    EmulatedRig(load_vehicle()).step()


@pytest.fixture
def ros_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, str]]:
    """Environment for processes that run nodes, set in this process too.

    None of them may outlive the test.
    """
    # a command in a test of another worker may have chosen one of these for itself
    domains = (processes.own_domain(test, _pid) for test in _tests)
    domain = next(domain for domain in domains if not processes.participants(domain))
    env = processes.ros_environment(domain=domain, log_dir=tmp_path / "ros_log")
    for name, value in env.items():
        monkeypatch.setenv(name, value)
    yield env
    deadline = time.monotonic() + PATIENCE
    while left := node_processes(tmp_path):
        if time.monotonic() > deadline:
            for process in left:
                os.kill(process, signal.SIGKILL)
            pytest.fail(f"processes have outlived the test: {left}")
        time.sleep(0.05)


def _wait_for_quiet(node: Node) -> None:
    """Wait until no node has come or gone for a while.

    Fast DDS 2.14 may end a participant never (`set_listener` spins) while it hears that another
    process ends.
    """
    names, since = node.get_node_names(), time.monotonic()
    while time.monotonic() - since < QUIET:
        time.sleep(0.01)
        if (now := node.get_node_names()) != names:
            names, since = now, time.monotonic()


@pytest.fixture
def ros_node(ros_environment: dict[str, str]) -> Iterator[Node]:
    """A node in a context of its own, on the test's domain; the test spins it."""
    context = Context()
    rclpy.init(context=context, domain_id=int(ros_environment["ROS_DOMAIN_ID"]))
    node = rclpy.create_node("test_observer", context=context)
    yield node
    _wait_for_quiet(node)
    node.destroy_node()
    rclpy.shutdown(context=context)
