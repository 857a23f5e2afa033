"""Replayer: how far from its recorded time a message is published, at rate 1.

    python benchmarks/replayer.py [--seconds 20]

A bag with four topics at 100 Hz is played by the node; a subscriber in this process notes when
the middleware says each message was sent. Its difference from the recorded stamp, less the
smallest one, is the timing error. Beside it, on the same machine at the same time: a thread that
sleeps until the same moments and does nothing.
"""

import argparse
import os
import subprocess
import tempfile
import time
from pathlib import Path
from threading import Thread

import numpy as np
import rclpy
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from std_srvs.srv import Trigger

from trajectory_recorder.bag.topics import Topic
from trajectory_recorder.bag.writer import BagWriter
from tricycle_cli.operation.processes import executable, own_domain, ros_environment

TOPICS = ("/odom", "/imu", "/joint_states", "/joint_commands")


def make_bag(path: Path, seconds: float) -> np.ndarray:
    """Stamps of the bag, ns."""
    rng = np.random.default_rng(0)
    count = round(seconds * 100)
    stamps = np.cumsum(rng.uniform(0.005, 0.015, count) * 1e9).astype(np.int64)
    message = b"\0\1\0\0" + bytes(716)
    with BagWriter(path) as bag:
        ids = [bag.add_topic(Topic.of_type(name, "nav_msgs/msg/Odometry")) for name in TOPICS]
        for stamp in stamps.tolist():
            for topic in ids:
                bag.write(topic, stamp, message)
    return stamps


def sleeper(stamps: np.ndarray, late: list[float]) -> None:
    begin = time.monotonic() - stamps[0] * 1e-9
    for stamp in stamps * 1e-9:
        time.sleep(max(0.0, begin + stamp - time.monotonic()))
        late.append(time.monotonic() - begin - stamp)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=20.0)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as directory:
        stamps = make_bag(Path(directory, "bag"), args.seconds)
        env = ros_environment(domain=own_domain(), log_dir=Path(directory, "log"))
        os.environ.update(env)
        rclpy.init()
        node = rclpy.create_node("observer")
        sent: list[int] = []
        node.create_subscription(
            Odometry, "odom", lambda _, info: sent.append(info["source_timestamp"]),
            QoSProfile(depth=1000), raw=True,
        )  # fmt: skip
        command = [executable("bag_replayer"), "--ros-args", "-p", f"bag:={directory}/bag"]
        replayer = subprocess.Popen([*command, "-p", "paused:=true"], env=env)
        while not node.count_publishers("/odom"):
            rclpy.spin_once(node, timeout_sec=0.1)
        client = node.create_client(Trigger, "bag_replayer/resume")
        client.wait_for_service()
        client.call_async(Trigger.Request())
        late: list[float] = []
        thread = Thread(target=sleeper, args=(stamps, late))
        thread.start()
        while replayer.poll() is None:
            rclpy.spin_once(node, timeout_sec=0.1)
        thread.join()
        rclpy.shutdown()
    error = (np.array(sent) - stamps[-len(sent) :]) * 1e-6
    for name, ms in (("bag_replayer", error - error.min()), ("bare sleep", np.array(late) * 1e3)):
        p50, p99 = np.percentile(ms, [50, 99])
        print(f"{name}: timing error p50 {p50:.2f} ms, p99 {p99:.2f} ms, max {ms.max():.2f} ms")
    print(f"{len(sent)} of {len(stamps)} messages; load average {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
