"""Recorder nodes killed with SIGKILL at random moments: what their bags still hold.

    python benchmarks/recorder_kills.py [--kills 50] [--seed 0]

A process publishes 2000 numbered messages/s to a recorder and notes when it sent each. What counts
is what `rosbags` and `mcap` find: in the bag as it was left or, where the kill tore a write, after
`tricycle bag recover`. Lost is the time from sending the first message that is not in the bag to
the kill. Exits with 1 if more than the last second is lost, if anything in between is missing, or
if a bag does not open.

A fifth as many kills follow with one publisher for all recorders. The middleware then looks for a
second for the one that was killed before it serves its successor, which so begins with a backlog:
killed at once, it loses more.
"""

import argparse
import random
import struct
import subprocess
import sys
import tempfile
import textwrap
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mcap.exceptions import McapError
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader, ReaderError

from trajectory_recorder.bag.recovery import recover
from trajectory_recorder.bag.topics import deserialize
from tricycle_cli.operation.processes import executable, own_domain, ros_environment

PUBLISHER = textwrap.dedent(
    """
    import itertools, struct, sys, time, rclpy
    from std_msgs.msg import String
    rclpy.init()
    publisher = rclpy.create_node("load").create_publisher(String, "odom", 10_000)
    begin = time.monotonic()
    sent = open(sys.argv[1], "wb", buffering=0)
    for number in itertools.count():
        sent.write(struct.pack("<d", time.time()))
        publisher.publish(String(data=f"{number} {'x' * 700}"))
        time.sleep(max(0.0, begin + number / 2000 - time.monotonic()))
    """
)


def of_rosbags(path: Path) -> list[bytes]:
    with Reader(path) as reader:
        return [bytes(data) for _, _, data in reader.messages()]


def of_mcap(path: Path) -> list[bytes]:
    (file,) = path.glob("*.mcap")
    with file.open("rb") as stream:
        return [message.data for _, _, message in make_reader(stream).iter_messages()]


def record_and_kill(bag: Path, env: dict[str, str], seconds: float) -> float:
    """Time of the kill [s], so many seconds after the first message was written."""
    command = [executable("trajectory_recorder"), "--ros-args", "-p", "record:=true"]
    command += ["-p", f"output:={bag}", "-p", "topics:=[odom]", "-p", "disk_reserve:=0.0"]
    file = bag / f"{bag.name}_0.mcap"
    with subprocess.Popen(command, env=env) as recorder:
        while not (file.exists() and file.stat().st_size > 10_000):
            time.sleep(0.001)
        time.sleep(seconds)
        recorder.kill()
        return time.time()


def found(bag: Path) -> tuple[list[int], bool]:
    """Numbers of the messages, and whether the bag had to be recovered."""
    torn = False
    try:
        messages, again = of_rosbags(bag), of_mcap(bag)
    except (ReaderError, McapError, MemoryError, OverflowError):
        torn, whole = True, bag.with_name(f"{bag.name}_recovered")
        recover(bag, whole)
        messages, again = of_rosbags(whole), of_mcap(whole)
    if messages != again:
        raise SystemExit(f"{bag}: the two readers differ")
    return [
        int(deserialize("std_msgs/msg/String", data).data.split()[0]) for data in messages
    ], torn


@contextmanager
def publishing(sent: Path, env: dict[str, str]) -> Iterator[Path]:
    """The file in which a running publisher notes when it sent each message."""
    with subprocess.Popen([sys.executable, "-c", PUBLISHER, sent], env=env) as publisher:
        try:
            yield sent
        finally:
            publisher.kill()


def series(directory: Path, kills: int, rng: random.Random, *, fresh: bool) -> int:
    """Print what so many kills lost; exit status."""
    env = ros_environment(domain=own_domain(), log_dir=directory / "log")
    bags = [directory / f"bag{i}_{fresh}" for i in range(kills)]
    lost, gaps, torn_bags, kept = [], 0, 0, 0
    for group in [[bag] for bag in bags] if fresh else [bags]:
        with publishing(group[0].with_suffix(".sent"), env) as sent:
            for bag in group:
                killed = record_and_kill(bag, env, rng.uniform(0.0, 1.5))
                numbers, torn = found(bag)
                gaps += numbers != list(range(numbers[0], numbers[0] + len(numbers)))
                (first_lost,) = struct.unpack_from("<d", sent.read_bytes(), 8 * (numbers[-1] + 1))
                lost.append(max(killed - first_lost, 0.0))
                torn_bags += torn
                kept += len(numbers)
    print(
        f"{kills} kills, {'a publisher each' if fresh else 'one publisher for all'}: "
        f"{sum(lost) / len(lost):.2f} s lost on average, {max(lost):.2f} s at most; {torn_bags} "
        f"bags torn within a write and recovered; {gaps} with a gap; {kept} messages found, the "
        f"same by rosbags and mcap"
    )
    return int(max(lost) > 1.0 or gaps > 0)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    rng = random.Random(args.seed)
    with tempfile.TemporaryDirectory() as directory:
        status = series(Path(directory), args.kills, rng, fresh=True)
        series(Path(directory), max(args.kills // 5, 1), rng, fresh=False)
    return status


if __name__ == "__main__":
    sys.exit(main())
