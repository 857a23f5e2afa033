"""Judge: speed and memory on a large bag, mostly of other topics.

    python benchmarks/judge.py [--gigabytes 2] [--compression none|lz4|zstd]

A drive is recorded among 1 MB images and 1 kHz IMU messages. It is judged on one core from the
page cache, in a process of its own whose peak memory is told, beside a process in which `rosbags`
reads every message and decodes the poses, and one in which `rosbags` reads the poses only.
"""

import argparse
import math
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from trajectory_recorder.bag.topics import OfferedQos, Topic, jazzy
from trajectory_recorder.bag.writer import BagWriter, Compression

TYPES = {
    "/odom": "nav_msgs/msg/Odometry",
    "/maneuver/reference": "nav_msgs/msg/Path",
    "/maneuver/state": "diagnostic_msgs/msg/DiagnosticStatus",
    "/image": "sensor_msgs/msg/Image",
    "/imu": "sensor_msgs/msg/Imu",
}
DURATION = 60.0  # s
START = 1_700_000_000 * 10**9  # ns


def _make(type_name: str, /, **values: object) -> object:
    return jazzy().types[type_name](**values)


def _header(ns: int) -> object:
    stamp = _make("builtin_interfaces/msg/Time", sec=ns // 10**9, nanosec=ns % 10**9)
    return _make("std_msgs/msg/Header", stamp=stamp, frame_id="odom")


def _pose(t: float) -> object:
    """Position at time t of a start at rest and a circle of 4 m at 1 m/s."""
    s = t**2 / 2 if t < 1 else t - 0.5
    s, heading = (s, s / 4) if t > 0 else (0.0, 0.0)
    return _make(
        "geometry_msgs/msg/Pose",
        position=_make(
            "geometry_msgs/msg/Point",
            x=4 * math.sin(heading), y=4 * (1 - math.cos(heading)), z=0.0,
        ),
        orientation=_make(
            "geometry_msgs/msg/Quaternion",
            x=0.0, y=0.0, z=math.sin(heading / 2), w=math.cos(heading / 2),
        ),
    )  # fmt: skip


def _odometry(t: float) -> object:
    zero = _make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    return _make(
        TYPES["/odom"],
        header=_header(START + round(t * 1e9)),
        child_frame_id="base_link",
        pose=_make("geometry_msgs/msg/PoseWithCovariance", pose=_pose(t), covariance=np.zeros(36)),
        twist=_make(
            "geometry_msgs/msg/TwistWithCovariance",
            twist=_make("geometry_msgs/msg/Twist", linear=zero, angular=zero),
            covariance=np.zeros(36),
        ),
    )


def make_bag(path: Path, size: float, compression: Compression) -> None:
    """Bag of about ``size`` bytes."""
    store = jazzy()
    poses = [
        _make("geometry_msgs/msg/PoseStamped", header=_header(i * 10**7), pose=_pose(i * 0.01))
        for i in range(round(DURATION * 100) + 1)
    ]
    reference = _make(TYPES["/maneuver/reference"], header=_header(0), poses=poses)
    values = {"state": "running", "start_time": f"{START // 10**9}.0", "duration": str(DURATION)}
    state = _make(
        TYPES["/maneuver/state"], level=0, name="", message="running", hardware_id="",
        values=[_make("diagnostic_msgs/msg/KeyValue", key=k, value=v) for k, v in values.items()],
    )  # fmt: skip
    image = os.urandom(10**6 // 2) + bytes(10**6 // 2)
    ticks = round((DURATION + 4) * 100)
    images = size / 1e6 / ticks  # per tick
    latched = (OfferedQos(durability="transient_local", depth=1),)
    with BagWriter(path, compression=compression) as bag:
        ids = {
            name: bag.add_topic(
                Topic.of_type(name, kind, qos=latched if "maneuver" in name else ())
            )
            for name, kind in TYPES.items()
        }

        def write(name: str, ns: int, message: object) -> None:
            bag.write(ids[name], ns, bytes(store.serialize_cdr(message, TYPES[name])))

        write("/maneuver/reference", START - 2 * 10**9, reference)
        done = 0
        for tick in range(ticks):
            t = tick * 0.01 - 2
            ns = START + round(t * 1e9)
            if tick == 200:
                write("/maneuver/state", ns, state)
            write("/odom", ns, _odometry(t))
            for i in range(10):
                bag.write(ids["/imu"], ns + i * 10**6, bytes(324))
            while done < images * tick:
                bag.write(ids["/image"], ns, image)
                done += 1


IMPORTS = """
import os, resource, sys, time
from pathlib import Path
from parameter_identification.judging.judgement import judge
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore
store = get_typestore(Stores.ROS2_JAZZY)
os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
path = Path(sys.argv[1])
size = sum(file.stat().st_size for file in path.glob("*.mcap"))
begin = time.perf_counter()
"""
READERS = {
    "judge": """
print(f"TE {judge(path).te:.3g} m²", end=", ")
""",
    "rosbags, everything": """
with Reader(path) as reader:
    for connection, _, data in reader.messages():
        if connection.topic == "/odom":
            store.deserialize_cdr(data, connection.msgtype)
""",
    "rosbags, poses only": """
with Reader(path) as reader:
    poses = [c for c in reader.connections if c.topic == "/odom"]
    for connection, _, data in reader.messages(poses):
        store.deserialize_cdr(data, connection.msgtype)
""",
}
REPORT = """
seconds = time.perf_counter() - begin
memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(f"{seconds:.2f} s, {size / seconds / 1e6:.0f} MB/s, {memory:.0f} MiB at most")
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--gigabytes", type=float, default=2.0)
    parser.add_argument("--compression", choices=["none", "lz4", "zstd"], default="none")
    args = parser.parse_args()
    compression = Compression(args.compression.replace("none", ""))
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory, "bag")
        make_bag(path, args.gigabytes * 1e9, compression)
        size = sum(file.stat().st_size for file in path.iterdir())
        print(f"{size / 1e9:.2f} GB, compression {args.compression}; load {os.getloadavg()[0]:.1f}")
        subprocess.run(["cat", *path.glob("*.mcap")], stdout=subprocess.DEVNULL, check=True)
        for name, body in READERS.items():
            print(f"{name}: ", end="", flush=True)
            subprocess.run([sys.executable, "-c", IMPORTS + body + REPORT, path], check=True)


if __name__ == "__main__":
    main()
