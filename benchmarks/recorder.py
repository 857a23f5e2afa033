"""Recorder: throughput of the writer, and of the node under load.

    python benchmarks/recorder.py [--seconds 10]

1. Writer: MB/s and messages/s of `BagWriter` beside `rosbags`' writer and `mcap`'s own, in one
   process, on 1 MB and on 720 B messages, and beside a plain write of the same bytes; the best of
   interleaved rounds.
2. Node: a process publishes Odometry at 10 000 messages/s; what the recorder's bag holds of it.
   Then 1 MB messages at 1 kHz, as Fast DDS comes (by UDP) and with room for such messages in its
   shared memory; each beside a subscription that is drained and writes nothing: what the
   middleware delivers. At last what the disk takes.
"""

import argparse
import itertools
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import textwrap
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter

from trajectory_recorder.bag.reader import BagReader
from trajectory_recorder.bag.topics import Topic, jazzy
from trajectory_recorder.bag.writer import BagWriter, Compression
from tricycle_cli.operation.processes import executable, own_domain, ros_environment

ODOMETRY = Topic.of_type("/odom", "nav_msgs/msg/Odometry")


def with_bag_writer(path: Path, messages: Iterator[bytes], compression: Compression) -> None:
    with BagWriter(path, compression=compression) as bag:
        topic = bag.add_topic(ODOMETRY)
        for stamp, data in enumerate(messages):
            bag.write(topic, stamp, data)


def with_rosbags(path: Path, messages: Iterator[bytes]) -> None:
    with RosbagsWriter(path, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        topic = bag.add_connection(ODOMETRY.name, ODOMETRY.type, typestore=jazzy())
        for stamp, data in enumerate(messages):
            bag.write(topic, stamp, data)


def with_mcap(path: Path, messages: Iterator[bytes]) -> None:
    path.mkdir()
    with (path / "bag.mcap").open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start(profile="ros2")
        schema = writer.register_schema(ODOMETRY.type, "ros2msg", ODOMETRY.definition.encode())
        channel = writer.register_channel(ODOMETRY.name, "cdr", schema)
        for stamp, data in enumerate(messages):
            writer.add_message(channel, stamp, data, stamp)
        writer.finish()


def with_plain_write(path: Path, messages: Iterator[bytes]) -> None:
    path.mkdir()
    with (path / "bytes").open("wb") as stream:
        for data in messages:
            stream.write(data)


WRITERS: dict[str, Callable[[Path, Iterator[bytes]], None]] = {
    "BagWriter": lambda path, m: with_bag_writer(path, m, Compression.NONE),
    "BagWriter, lz4": lambda path, m: with_bag_writer(path, m, Compression.LZ4),
    "BagWriter, zstd": lambda path, m: with_bag_writer(path, m, Compression.ZSTD),
    "rosbags' writer": with_rosbags,
    "mcap's writer": with_mcap,
    "plain write": with_plain_write,
}


def bench_writers(directory: Path, rounds: int = 5) -> None:
    best: dict[tuple[str, int], float] = {}
    for _ in range(rounds):
        for size, count in ((10**6, 300), (720, 100_000)):
            data = os.urandom(size // 2) + bytes(size - size // 2)  # half of it compresses
            for name, write in WRITERS.items():
                path = directory / "bag"
                begin = time.perf_counter()
                write(path, itertools.repeat(data, count))
                rate = count / (time.perf_counter() - begin)
                best[name, size] = max(rate, best.get((name, size), 0.0))
                shutil.rmtree(path)
    print(f"{'':18}{'1 MB messages':>16}{'720 B messages':>18}")
    for name in WRITERS:
        large, small = best[name, 10**6], best[name, 720]
        print(f"{name:18}{large:11.0f} MB/s{small * 720e-6:13.0f} MB/s{small:10.0f} /s")


PUBLISHER = textwrap.dedent(
    """
    import sys, time, rclpy
    from nav_msgs.msg import Odometry
    from sensor_msgs.msg import Image
    from rclpy.qos import QoSProfile
    from rclpy.serialization import serialize_message
    kind, rate, seconds = sys.argv[1], float(sys.argv[2]), float(sys.argv[3])
    rclpy.init()
    node = rclpy.create_node("load")
    if kind == "odom":
        message = serialize_message(Odometry())
        publisher = node.create_publisher(Odometry, "odom", QoSProfile(depth=10_000))
    else:
        message = serialize_message(Image(data=bytes(10**6)))
        publisher = node.create_publisher(Image, "odom", QoSProfile(depth=5))
    while not publisher.get_subscription_count():
        time.sleep(0.01)
    begin, sent = time.monotonic(), 0
    while (elapsed := time.monotonic() - begin) < seconds:
        while sent < elapsed * rate and time.monotonic() - begin < seconds:
            publisher.publish(message)
            sent += 1
        time.sleep(0.0005)
    print(sent, time.monotonic() - begin, flush=True)
    time.sleep(2)
    """
)


# 1 MB does not fit into the 512 kB of shared memory that Fast DDS takes, and goes by UDP then
LARGE_MESSAGES = """<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"><profiles>
  <transport_descriptors>
    <transport_descriptor>
      <transport_id>large</transport_id><type>SHM</type>
      <segment_size>268435456</segment_size><maxMessageSize>4000000</maxMessageSize>
    </transport_descriptor>
  </transport_descriptors>
  <participant profile_name="large" is_default_profile="true"><rtps>
    <userTransports><transport_id>large</transport_id></userTransports>
    <useBuiltinTransports>false</useBuiltinTransports>
  </rtps></participant>
</profiles></dds>
"""


DRAIN = textwrap.dedent(
    """
    import signal, rclpy
    from sensor_msgs.msg import Image
    from rclpy.qos import QoSProfile
    rclpy.init()
    node, taken = rclpy.create_node("drain"), 0
    def drain(_):
        global taken
        taken += 1
        with subscription.handle:
            while subscription.handle.take_message(subscription.msg_type, True) is not None:
                taken += 1
    subscription = node.create_subscription(Image, "odom", drain, QoSProfile(depth=1000), raw=True)
    stopped = False
    def stop(*_):
        global stopped
        stopped = True
    signal.signal(signal.SIGINT, stop)
    while not stopped:
        rclpy.spin_once(node, timeout_sec=0.1)
    print(taken)
    """
)


def publish_to(
    subscriber: list[str], env: dict[str, str], kind: str, rate: int, seconds: float
) -> tuple[float, float, float, str]:
    """Messages sent, seconds, the subscriber's CPU seconds and its output."""
    with subprocess.Popen(subscriber, env=env, stdout=subprocess.PIPE, text=True) as process:
        load = subprocess.run(
            [sys.executable, "-c", PUBLISHER, kind, str(rate), str(seconds)],
            env=env, check=True, capture_output=True, text=True,
        )  # fmt: skip
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        process.send_signal(signal.SIGINT)
        output, _ = process.communicate()
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    sent, elapsed = (float(word) for word in load.stdout.split())
    return sent, elapsed, cpu, output


def disk_rate(directory: Path, megabytes: int = 1000) -> float:
    data = os.urandom(10**6)
    begin = time.perf_counter()
    with (directory / "disk").open("wb") as file:
        for _ in range(megabytes):
            file.write(data)
        os.fsync(file.fileno())
    return megabytes / (time.perf_counter() - begin)


def bench_node(directory: Path, seconds: float) -> None:
    env = ros_environment(domain=own_domain(), log_dir=directory / "log")
    profile = directory / "large_messages.xml"
    profile.write_text(LARGE_MESSAGES)
    large = {**env, "FASTRTPS_DEFAULT_PROFILES_FILE": str(profile)}
    for kind, rate, size, env_ in (
        ("odom", 10_000, 720e-6, env),
        ("image", 1000, 1.0, env),
        ("image, 256 MB of shared memory", 1000, 1.0, large),
    ):
        bag = directory / "bag"
        recorder = [executable("trajectory_recorder"), "--ros-args"]
        for parameter in ("record:=true", f"output:={bag}", "topics:=[odom]", "compression:=none"):
            recorder += ["-p", parameter]
        sent, elapsed, cpu, _ = publish_to(recorder, env_, kind, rate, seconds)
        with BagReader(bag) as reader:
            recorded = reader.topics["/odom"].count
        shutil.rmtree(bag)
        drained = ""
        if kind != "odom":
            _, drained_for, _, output = publish_to(
                [sys.executable, "-c", DRAIN], env_, "image", rate, seconds
            )
            drained = f"; drained without writing: {int(output) / drained_for:.0f} MB/s"
        print(
            f"{kind}: {sent / elapsed:.0f} messages/s published for {elapsed:.0f} s; recorded "
            f"{recorded} of {sent:.0f}, {sent - recorded:.0f} lost; "
            f"{recorded * size / elapsed:.0f} MB/s; recorder's CPU {cpu / elapsed:.0%} of one "
            f"core, {1e6 * cpu / max(recorded, 1):.0f} µs per message{drained}"
        )
    print(f"disk: {disk_rate(directory):.0f} MB/s written and synchronised")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=10.0, help="of load on the node")
    parser.add_argument("--directory", type=Path, help="where to write; default: temporary")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=args.directory) as directory:
        bench_writers(Path(directory))
        bench_node(Path(directory), args.seconds)


if __name__ == "__main__":
    main()
