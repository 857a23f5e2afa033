"""Processes killed while they write: what two independent readers still find.

`benchmarks/recorder_kills.py` kills fifty real recorder nodes and measures the seconds lost.
"""

import random
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest
from mcap.exceptions import McapError
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader as RosbagsReader
from rosbags.rosbag2 import ReaderError

from trajectory_recorder.bag.reader import BagReader
from trajectory_recorder.bag.recovery import recover

KILLS = 10
# of readers that meet half a record; rosbags may take its bytes for a length that is no length
TORN = (ReaderError, McapError, MemoryError, OverflowError)

# Writes 2000 messages/s as the recorder does, flushing every 0.5 s, or, to be caught in the write
# itself more often, without a pause. Says after each flush how many messages the bag holds.
WRITER = textwrap.dedent(
    """
    import itertools, sys, time
    from pathlib import Path
    from trajectory_recorder.bag.writer import BagWriter
    from trajectory_recorder.bag.topics import Topic
    bag = BagWriter(Path(sys.argv[1]))
    topic = bag.add_topic(Topic.of_type("/odom", "nav_msgs/msg/Odometry"))
    period, flushed = float(sys.argv[2]), time.monotonic()
    for i in itertools.count():
        bag.write(topic, time.time_ns(), i.to_bytes(720, "little"))
        time.sleep(0.0005)
        if time.monotonic() - flushed >= period:
            bag.flush()
            print(i + 1, flush=True)
            flushed = time.monotonic()
    """
)


def stamps_of_rosbags(path: Path) -> list[int]:
    with RosbagsReader(path) as reader:
        return [stamp for _, stamp, _ in reader.messages()]


def stamps_of_mcap(path: Path) -> list[int]:
    (file,) = path.glob("*.mcap")
    with file.open("rb") as stream:
        return [message.log_time for _, _, message in make_reader(stream).iter_messages()]


@pytest.mark.slow
def test_kill_9_loses_nothing_that_was_flushed(tmp_path: Path) -> None:
    rng = random.Random(1)
    torn = 0
    for i in range(KILLS):
        path = tmp_path / f"{i}"
        period = "0.5" if i % 2 else "0"
        with subprocess.Popen(
            [sys.executable, "-c", WRITER, str(path), period], stdout=subprocess.PIPE
        ) as process:
            assert process.stdout is not None
            said = process.stdout.readline()
            time.sleep(rng.uniform(0.0, 1.2))
            process.kill()
            flushed = int((said + process.stdout.read()).split(b"\n")[-2])
        with BagReader(path) as reader:
            messages = list(reader.messages())
        # no message in the middle is missing, none is damaged
        assert [int.from_bytes(m.data, "little") for m in messages] == list(range(len(messages)))
        assert len(messages) >= flushed
        stamps = [m.stamp for m in messages]
        try:
            assert stamps_of_rosbags(path) == stamps
            assert stamps_of_mcap(path) == stamps
        except TORN:  # killed in the middle of a write
            torn += 1
            recovered = tmp_path / f"recovered_{path.name}"
            recover(path, recovered)
            assert stamps_of_rosbags(recovered) == stamps
            assert stamps_of_mcap(recovered) == stamps
    print(f"{KILLS} kills, {torn} bags torn in the write")
    assert torn <= KILLS / 5
