"""Live nodes: a domain of its own per test worker, discovery that takes milliseconds."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from tricycle_bringup.processes import ros_environment as environment_of


@pytest.fixture
def ros_environment(tmp_path: Path, worker_id: str, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """Environment for processes that run nodes; set in this process too."""
    worker = int(worker_id.removeprefix("gw")) if worker_id.startswith("gw") else 0
    domain = 40 + (os.getpid() % 50) + 50 * (worker % 2)  # 40..139; Fast DDS allows up to 232
    env = environment_of(domain=domain, log_dir=tmp_path / "log")
    for name in ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE", "FASTRTPS_DEFAULT_PROFILES_FILE", "ROS_LOG_DIR"):
        monkeypatch.setenv(name, env[name])
    return env


@pytest.fixture
def ros_node(ros_environment: dict[str, str]) -> Iterator["rclpy.node.Node"]:
    """A node in a context of its own, on the test's domain."""
    import rclpy
    from rclpy.context import Context
    from rclpy.executors import SingleThreadedExecutor

    context = Context()
    rclpy.init(context=context, domain_id=int(ros_environment["ROS_DOMAIN_ID"]))
    node = rclpy.create_node("test_observer", context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    yield node
    executor.shutdown()
    node.destroy_node()
    rclpy.try_shutdown(context=context)
