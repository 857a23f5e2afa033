"""Playing order, spacing, pause and step; times are those of the wall clock."""

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from threading import Thread

import pytest

from trajectory_recorder.bag.reader import BagReader, RecordedMessage
from trajectory_recorder.bag.topics import OfferedQos, Topic
from trajectory_recorder.bag.writer import BagWriter
from trajectory_recorder.player import CLOCK_PERIOD, Player

LATCHED = (OfferedQos(durability="transient_local"),)
MS = 1_000_000  # ns


@pytest.fixture
def bag(tmp_path: Path) -> BagReader:
    """/plan at 0 ms, /odom every 10 ms from 5 ms to 305 ms."""
    with BagWriter(tmp_path / "bag") as writer:
        plan = writer.add_topic(Topic.of_type("/plan", "std_msgs/msg/String", qos=LATCHED))
        odom = writer.add_topic(Topic.of_type("/odom", "std_msgs/msg/String"))
        writer.write(plan, 0, b"")
        for i in range(31):
            writer.write(odom, (5 + 10 * i) * MS, b"")
    return BagReader(tmp_path / "bag")


def play(player: Player) -> tuple[list[tuple[float, RecordedMessage]], list[int]]:
    played: list[tuple[float, RecordedMessage]] = []
    ticks: list[int] = []
    begin = time.monotonic()
    player.run(lambda m: played.append((time.monotonic() - begin, m)), ticks.append)
    return played, ticks


def until(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 10
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.001)


@pytest.mark.real_time
def test_messages_come_no_earlier_than_recorded_and_with_a_clock(bag: BagReader) -> None:
    played, ticks = play(Player(bag, bag.topics))
    assert [m for _, m in played] == list(bag.messages())
    assert all(at >= m.stamp * 1e-9 - 1e-6 for at, m in played)
    assert played[-1][0] < 0.305 + 0.2
    assert ticks == list(range(0, 305 * MS, CLOCK_PERIOD))


@pytest.mark.real_time
def test_rate_start_and_topics(bag: BagReader) -> None:
    played, _ = play(Player(bag, ["/odom"], rate=10))
    assert len(played) == 31
    assert 0.03 - 1e-6 <= played[-1][0] < 0.15
    played, _ = play(Player(bag, bag.topics, rate=0, start=0.1))
    assert [(m.topic, m.stamp) for _, m in played[:2]] == [("/plan", 0), ("/odom", 105 * MS)]
    assert played[-1][0] < 0.1


def test_pause_step_and_stop(bag: BagReader) -> None:
    played: list[RecordedMessage] = []
    player = Player(bag, bag.topics, paused=True)
    thread = Thread(target=player.run, args=(played.append, lambda _: None))
    thread.start()
    assert player.step()
    until(lambda: len(played) == 1)
    assert player.step()
    assert player.step()
    until(lambda: len(played) == 3)
    player.resume()
    assert not player.step()
    until(lambda: len(played) > 5)
    player.pause()
    player.stop()
    thread.join(5)
    assert not thread.is_alive()
    assert len(played) < 32


def test_seek_goes_forward_and_back_and_tells_the_latched_topics_again(bag: BagReader) -> None:
    played: list[tuple[str, int]] = []
    ticks: list[int] = []
    player = Player(bag, bag.topics, paused=True)
    thread = Thread(
        target=player.run, args=(lambda m: played.append((m.topic, m.stamp // MS)), ticks.append)
    )
    thread.start()
    for start in (0.2, 0.1):
        player.seek(start)
        assert player.step()
        until(partial(played.__contains__, ("/odom", round(start * 1000) + 5)))
    assert played == [("/plan", 0), ("/odom", 205), ("/plan", 0), ("/odom", 105)]
    player.resume()
    thread.join(5)
    assert [stamp for _, stamp in played[3:]] == list(range(105, 306, 10))
    assert ticks[-1] // MS == 305


def test_of_earlier_latched_messages_the_newest_are_played(tmp_path: Path) -> None:
    one = (OfferedQos(durability="transient_local", depth=1),)
    with BagWriter(tmp_path / "plans") as writer:
        plan = writer.add_topic(Topic.of_type("/plan", "std_msgs/msg/String", qos=one))
        for stamp in range(5):
            writer.write(plan, stamp * MS, b"")
    with BagReader(tmp_path / "plans") as plans:
        played, _ = play(Player(plans, plans.topics, start=0.003, rate=0))
    assert [message.stamp // MS for _, message in played] == [2, 3, 4]


def test_loop_begins_again(bag: BagReader) -> None:
    played: list[int] = []
    player = Player(bag, bag.topics, rate=0, loop=True)

    def publish(message: RecordedMessage) -> None:
        played.append(message.stamp)
        if len(played) == 100:
            player.stop()

    player.run(publish, lambda _: None)
    assert len(played) == 100
    assert played[:32] == played[32:64]


@pytest.mark.parametrize("rate", [1e-13, 5e-324])
@pytest.mark.parametrize("topics", [["/odom"], ["/plan"]])
def test_a_rate_that_would_take_ages_waits(bag: BagReader, topics: list[str], rate: float) -> None:
    """For the next message, or for the next pass of a loop."""
    played: list[RecordedMessage] = []
    player = Player(bag, topics, rate=rate, loop=True)
    thread = Thread(target=player.run, args=(played.append, lambda _: None))
    thread.start()
    until(lambda: len(played) == 1)
    time.sleep(0.05)
    assert thread.is_alive()
    player.stop()
    thread.join(5)
    assert not thread.is_alive()
    assert len(played) == 1


@pytest.mark.parametrize("start", [0.0, 0.1])
def test_a_loop_of_one_message_does_not_flood(bag: BagReader, start: float) -> None:
    played: list[RecordedMessage] = []
    player = Player(bag, ["/plan"], start=start, loop=True)
    thread = Thread(target=player.run, args=(played.append, lambda _: None))
    begin = time.monotonic()
    thread.start()
    until(lambda: len(played) >= 5)
    took = time.monotonic() - begin
    player.stop()
    thread.join()
    assert took >= 0.04


def test_a_player_stops_also_while_it_skips(bag: BagReader) -> None:
    played: list[RecordedMessage] = []

    def publish(message: RecordedMessage) -> None:
        played.append(message)
        player.stop()

    player = Player(bag, ["/plan", "/odom"], start=1.0, loop=True)
    player.run(publish, lambda _: None)
    assert [m.topic for m in played] == ["/plan"]


def test_topics_that_were_written_one_after_the_other_play_by_stamp(tmp_path: Path) -> None:
    """As a recorder that is behind writes them, over several chunks and files."""
    with BagWriter(tmp_path / "bag", chunk_size=200, split_duration=0.1) as writer:
        odom = writer.add_topic(Topic.of_type("/odom", "std_msgs/msg/String"))
        imu = writer.add_topic(Topic.of_type("/imu", "std_msgs/msg/String"))
        for batch in range(0, 300, 50):
            for topic in (odom, imu):
                for ms in range(batch, batch + 50, 10):
                    writer.write(topic, ms * MS, b"")
            writer.flush()
    with BagReader(tmp_path / "bag") as reader:
        played, ticks = play(Player(reader, reader.topics))
    assert [(m.stamp, m.topic) for _, m in played] == [
        (ms * MS, topic) for ms in range(0, 300, 10) for topic in ("/odom", "/imu")
    ]
    assert ticks == list(range(0, 300 * MS, CLOCK_PERIOD))
    assert 0.29 - 1e-6 <= played[-1][0] < 0.29 + 0.2


def test_duration_ends_playing(bag: BagReader) -> None:
    played, _ = play(Player(bag, ["/odom"], rate=0, start=0.1, duration=0.05))
    assert [m.stamp for _, m in played] == [ms * MS for ms in range(105, 151, 10)]


def test_start_counts_from_the_begin_of_the_bag(tmp_path: Path) -> None:
    """As in `bag convert`, not from the first message of what is played."""
    with BagWriter(tmp_path / "bag") as writer:
        imu = writer.add_topic(Topic.of_type("/imu", "std_msgs/msg/String"))
        odom = writer.add_topic(Topic.of_type("/odom", "std_msgs/msg/String"))
        writer.write(imu, 0, b"")
        for second in range(1, 5):
            writer.write(odom, second * 1000 * MS, b"")
    with BagReader(tmp_path / "bag") as reader:
        played, _ = play(Player(reader, ["/odom"], rate=0, start=2.0))
    assert [m.stamp // MS for _, m in played] == [2000, 3000, 4000]


def test_negative_rates_are_refused(bag: BagReader) -> None:
    with pytest.raises(ValueError, match="must not be negative"):
        Player(bag, bag.topics, rate=-1)
