"""The driver's state machine: rows at their times, standstill whenever anything is wrong."""

import numpy as np
import pytest

from excitation_planner.playback import JointCommand, PlanarState, Playback, PlaybackState, Schedule

AT_REST = PlanarState(1.0, 2.0, np.pi / 2, 0.0)
STANDSTILL = JointCommand(0.0, 0.0)


def schedule():
    return Schedule(np.array([0.0, 0.02, 0.04]), np.array([0.1, 0.2, 0.3]), np.array([1.0, 2.0, 3]))


def ready(now=10.0):
    playback = Playback(max_deviation=1.0, odom_timeout=0.5)
    playback.load(schedule())
    playback.observe(AT_REST, now)
    return playback


def test_rows_are_played_from_the_first_tick_after_the_start():
    playback = ready()
    assert playback.tick(10.0) == STANDSTILL
    playback.start(10.0)
    played = [playback.tick(t) for t in (10.01, 10.02, 10.03, 10.04)]
    assert played == [
        JointCommand(0.1, 1.0),
        JointCommand(0.1, 1.0),
        JointCommand(0.2, 2.0),
        JointCommand(0.2, 2),
    ]
    assert playback.start_time == 10.01
    assert playback.tick(10.05) == JointCommand(
        0.3, 0.0
    )  # the end: standstill, wheels left as they are
    assert playback.state is PlaybackState.DONE


def test_a_late_tick_plays_the_row_that_is_due():
    playback = ready()
    playback.start(10.0)
    playback.tick(10.0)
    assert playback.tick(10.03) == JointCommand(0.2, 2.0)


def test_loading_new_commands_returns_the_wheels_to_straight():
    playback = ready()
    playback.start(10.0)
    playback.tick(10.0)
    playback.tick(10.2)
    playback.load(schedule())
    assert playback.state is PlaybackState.WAITING
    assert playback.tick(10.3) == STANDSTILL


@pytest.mark.parametrize(
    ("prepare", "reason"),
    [
        (lambda: Playback(max_deviation=1.0, odom_timeout=0.5), "no commands yet"),
        (lambda: ready(now=9.0), "no pose on odom"),
    ],
)
def test_start_is_refused_with_its_reason(prepare, reason):
    with pytest.raises(ValueError, match=reason):
        prepare().start(10.0)


def test_a_moving_vehicle_does_not_start():
    playback = ready()
    playback.observe(PlanarState(0, 0, 0, 0.3), 10.0)
    with pytest.raises(ValueError, match=r"moves at 0\.30 m/s"):
        playback.start(10.0)


def test_a_running_maneuver_refuses_start_and_new_commands():
    playback = ready()
    playback.start(10.0)
    with pytest.raises(ValueError, match="already running"):
        playback.start(10.0)
    with pytest.raises(ValueError, match="abort it before"):
        playback.load(schedule())


def test_abort_stops_the_wheel_and_says_why():
    playback = ready()
    playback.start(10.0)
    playback.tick(10.0)
    playback.abort("asked for")
    assert playback.tick(10.02) == JointCommand(0.1, 0.0)
    assert (playback.state, playback.reason) == (PlaybackState.ABORTED, "asked for")
    with pytest.raises(ValueError, match="no maneuver is running"):
        playback.abort("again")


def test_losing_the_pose_aborts():
    playback = Playback(max_deviation=1.0, odom_timeout=0.01)
    playback.load(schedule())
    playback.observe(AT_REST, 10.0)
    playback.start(10.0)
    playback.tick(10.0)
    assert playback.tick(10.02) == JointCommand(0.1, 0.0)
    assert playback.reason == "no pose on odom for 0.02 s"


def test_leaving_the_path_aborts_wherever_the_start_was():
    playback = ready()
    playback.load_path(np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]))
    playback.start(10.0)
    playback.tick(10.0)
    playback.observe(
        PlanarState(1.0, 4.0, 0, 1), 10.01
    )  # 2 m along the path, which points along +y
    playback.tick(10.01)
    assert playback.state is PlaybackState.RUNNING
    playback.observe(PlanarState(-0.5, 4.0, 0, 1), 10.02)  # 1.5 m to the left of it
    playback.tick(10.02)
    assert playback.reason == "1.50 m off the path (limit 1 m)"


def test_the_path_is_that_of_the_commands_whatever_other_plans_are_published():
    own, other = np.array([[0.0, 0.0], [2.0, 0.0]]), np.array([[9.0, 9.0], [9.0, 8.0]])
    playback = ready()
    playback.load_path(other, stamp=1)
    playback.load(schedule(), stamp=2)
    with pytest.raises(ValueError, match="the path on maneuver/path is that of other commands"):
        playback.start(10.0)
    playback.load_path(own, stamp=2)
    playback.load_path(other, stamp=3)
    playback.start(10.0)
    playback.load_path(other, stamp=2)
    playback.tick(10.0)
    assert playback.state is PlaybackState.RUNNING


@pytest.mark.parametrize(
    ("time", "angle", "message"),
    [
        ([0.0, 0.0], [0.0, 0.0], "increase"),
        ([0.1, 0.2], [0.0, 0.0], "start at 0"),
        ([0.0], [0.0], "two rows"),
        ([0.0, 0.1], [0.0, float("nan")], "row 1 holds a number that is not finite"),
    ],
)
def test_a_schedule_is_checked(time, angle, message):
    with pytest.raises(ValueError, match=message):
        Schedule(np.array(time), np.array(angle), np.zeros(len(time)))
