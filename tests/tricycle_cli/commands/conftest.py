"""A small bag."""

from pathlib import Path

import pytest

from trajectory_recorder.bag.topics import OfferedQos, Topic
from trajectory_recorder.bag.writer import BagWriter, Compression


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    with BagWriter(
        tmp_path / "bag", metadata={"plan_id": "p1"}, compression=Compression.NONE
    ) as writer:
        topic = writer.add_topic(
            Topic.of_type("/chatter", "std_msgs/msg/String", qos=(OfferedQos(),))
        )
        for stamp in range(100):
            writer.write(topic, stamp, bytes(100))
            writer.flush()
    return tmp_path / "bag"
