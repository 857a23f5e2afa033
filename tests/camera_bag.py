"""A bag of a camera, which is most of it, and of a small topic that is wanted."""

from pathlib import Path

import numpy as np

from trajectory_recorder.bag.topics import Topic
from trajectory_recorder.bag.writer import BagWriter, Compression

WANTED = "/wanted"


def write_camera_bag(folder: Path, seconds: int) -> None:
    """Write so many seconds of both, ten messages a second, a chunk for each second."""
    noise = np.random.default_rng(0)
    with BagWriter(folder, compression=Compression.NONE) as bag:
        other, wanted = (
            bag.add_topic(Topic(name, "std_msgs/msg/String", definition="string data"))
            for name in ("/camera", WANTED)
        )
        for second in range(seconds):
            for _ in range(10):
                bag.write(other, second * 10**9, noise.bytes(20_000))
                bag.write(wanted, second * 10**9, noise.bytes(100))
            bag.flush()
