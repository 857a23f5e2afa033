"""Bags elsewhere: bytes and seconds to read a drive out of a bag that also holds a camera.

    python benchmarks/bags_elsewhere.py BAG [--megabytes 100]

BAG is a recorded drive, of `tricycle demo` for example. It is copied with images of 100 kB between
its messages, once by our writer and once with all topics in the same chunks, as other recorders
write. Each copy is read, as `tricycle identify` reads it, from the disk and from an object store
(moto, on this machine, so that the seconds are those of the requests and not of a network).
"""

import argparse
import logging
import os
import tempfile
import time
from pathlib import Path

import numpy as np
from moto.server import ThreadedMotoServer

from parameter_identification.drives.reader import read_drive
from trajectory_recorder.bag import writer
from trajectory_recorder.bag.location import bag_path
from trajectory_recorder.bag.reader import BagReader
from trajectory_recorder.bag.topics import Topic

IMAGE = 100_000  # bytes
CAMERA = Topic("/camera/image/compressed", "std_msgs/msg/String", definition="string data")
STORE = {
    "AWS_ACCESS_KEY_ID": "benchmark",
    "AWS_SECRET_ACCESS_KEY": "benchmark",
    "AWS_DEFAULT_REGION": "us-east-1",
}


def with_camera(bag: Path, output: Path, megabytes: float) -> None:
    """Copy a bag with images between its messages, flushed as often as the recorder does."""
    pixels = np.random.default_rng(0)
    with BagReader(bag) as reader, writer.BagWriter(output, metadata=reader.metadata) as copy:
        topics = {name: copy.add_topic(topic) for name, topic in reader.topics.items()}
        camera = copy.add_topic(CAMERA)
        (first, last), images = reader.span or (0, 0), round(megabytes * 1e6 / IMAGE)
        stamps = iter(np.linspace(first, last, images).astype(int).tolist())
        due, flushed = next(stamps), first
        for message in reader.messages_by_stamp():
            while due is not None and due <= message.stamp:
                copy.write(camera, due, pixels.bytes(IMAGE))
                due = next(stamps, None)
            copy.write(topics[message.topic], message.stamp, message.data)
            if message.stamp > flushed + 5 * 10**8:
                copy.flush()
                flushed = message.stamp


def read(path: Path) -> float:
    """Seconds to read the drive."""
    begin = time.perf_counter()
    read_drive(path)
    return time.perf_counter() - begin


def fetched(path: Path) -> tuple[int, int]:
    """Bytes received and bytes of the bag, of a read of the drive's topics."""
    with BagReader(path) as reader:
        for _ in reader.messages(reader.topics.keys() - {CAMERA.name}):
            pass
        return reader.fetched, reader.size


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bag", type=Path)
    parser.add_argument("--megabytes", type=float, default=100.0, help="of images")
    arguments = parser.parse_args()
    logging.getLogger("werkzeug").setLevel(logging.ERROR)  # else a line per request
    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    os.environ |= {"AWS_ENDPOINT_URL": f"http://{host}:{port}", **STORE}
    store = bag_path("s3://bags").fs
    store.mkdir("bags")
    apart = writer.LARGE
    with tempfile.TemporaryDirectory() as folder:
        for name, large in (("own", apart), ("mixed", 2**62)):
            writer.LARGE = large
            with_camera(arguments.bag, bag := Path(folder) / name, arguments.megabytes)
            store.put(str(bag), f"bags/{name}", recursive=True)
            there = bag_path(f"s3://bags/{name}")
            part, size = fetched(there)
            print(
                f"{name} chunks: {part / 1e6:.2f} of {size / 1e6:.1f} MB fetched "
                f"({part / size:.1%}); {read(there):.2f} s, from the disk {read(bag):.2f} s"
            )
    server.stop()


if __name__ == "__main__":
    main()
