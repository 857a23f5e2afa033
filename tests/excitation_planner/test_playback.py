"""The driver's state machine: rows at their times, standstill whenever anything is wrong."""

import itertools
import math
import re
from contextlib import suppress
from dataclasses import fields, replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from excitation_planner.localisation import PlanarState
from excitation_planner.playback import ARRIVAL, PREPARATION, JointCommand, Playback, PlaybackState
from excitation_planner.preflight import Check
from excitation_planner.schedule import MAX_ROWS, Schedule
from excitation_planner.vehicle_watch import VehicleWatch
from excitation_planner.way_back.dubins import Arc
from tricycle_core.diagnostics import Level
from tricycle_core.errors import PlanError
from tricycle_core.readiness import Readiness

WATCHED = {field.name for field in fields(VehicleWatch)}
AT_REST = PlanarState(1.0, 2.0, np.pi / 2, 0.0)
MOVING = PlanarState(1.0, 2.0, np.pi / 2, 0.8)
ARMED = Readiness(armed=True)
STOP = JointCommand(0.1, 0.0, stop=True)
PRESSED = Readiness(armed=False, reason="hardware e-stop pressed")
PATH = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])


def schedule():
    return Schedule(np.array([0.0, 0.02, 0.04]), np.array([0.1, 0.2, 0.3]), np.array([1.0, 2.0, 3]))


def ready(now=10.0, **options):
    of_watch = {name: options.pop(name) for name in WATCHED & options.keys()}
    watch = VehicleWatch(**{"odom_timeout": 0.5, **of_watch})
    playback = Playback(watch, **{"max_deviation": 1.0, **options})
    playback.load(schedule())
    playback.parts.add_path(PATH)
    playback.observe(AT_REST, now, now)
    playback.hear(ARMED, now)
    return playback


def running(now=10.0, **options):
    """A playback that has just played row 0."""
    playback = ready(now, **options)
    start(playback, now)
    playback.tick(now)
    return playback


def start(playback, now):
    """Start a playback so that row 0 is due now."""
    for t in (now - PREPARATION, now):
        playback.observe(AT_REST, t, t)
        playback.hear(ARMED, t)
        if t < now:
            playback.start(t)
            playback.tick(t)


def test_before_row_0_the_wheels_turn_to_its_angle():
    playback = ready()
    assert playback.tick(10.0) is None
    playback.start(10.0)
    assert playback.state is PlaybackState.STARTING
    for t in (10.01, 10.49):
        assert playback.tick(t) == JointCommand(0.1, 0.0)
    assert playback.start_time is None
    assert playback.tick(10.5) == JointCommand(0.1, 1.0)
    assert (playback.state, playback.start_time) == (PlaybackState.RUNNING, 10.5)


def test_rows_are_played_from_the_start_time():
    playback = ready()
    start(playback, 10.01)
    played = [playback.tick(t) for t in (10.01, 10.02, 10.03, 10.04)]
    assert played == [
        JointCommand(0.1, 1.0),
        JointCommand(0.1, 1.0),
        JointCommand(0.2, 2.0),
        JointCommand(0.2, 2),
    ]
    assert playback.start_time == 10.01
    end = JointCommand(0.3, 0.0)  # standstill, wheels left as they are
    assert playback.tick(10.05) == end
    assert playback.state is PlaybackState.DONE


def test_in_the_lead_in_the_steering_leads_back_to_the_line_and_then_the_rows_alone_count():
    playback = ready()
    playback.load(Schedule(np.array([0.0, 1.0]), np.array([0.1, 0.1]), np.array([1.0, 1.0])), 7)
    playback.parts.add_path(PATH, 7)
    playback.parts.add_lead_in(0.5, 7)
    playback.parts.add_lead_in(0.9, 8)  # of another plan
    playback.start(10.0)
    beside = replace(AT_REST, x=AT_REST.x - 0.1, speed=0.5)  # left of the line, which leads along y
    angles = {}
    for t in np.arange(10.0, 11.4, 0.01):
        if playback.start_time is None:
            playback.observe(AT_REST, t, t)
        else:
            along = beside.y + 0.5 * (t - playback.start_time)
            playback.observe(replace(beside, y=along), t, t)
        playback.hear(ARMED, t)
        command = playback.tick(t)
        if playback.start_time is not None:
            angles[round(t - playback.start_time, 2)] = command.steering_motor_angle
    assert angles[0.4] < 0.05  # to the right
    assert angles[0.49] < 0.05
    assert angles[0.5] == angles[0.8] == 0.1


def test_the_line_of_a_lead_in_is_where_the_vehicle_rests_not_where_it_came_from():
    playback = ready()
    playback.load(Schedule(np.array([0.0, 1.0]), np.array([0.1, 0.1]), np.array([1.0, 1.0])), 7)
    playback.parts.add_path(PATH, 7)
    playback.parts.add_lead_in(0.9, 7)
    for t in np.arange(9.0, 10.0, 0.02):  # in a turn until just before the start
        turn = 0.3 * (t - 10.0)
        y, yaw = AT_REST.y + turn, AT_REST.yaw + turn
        turning = replace(AT_REST, y=y, yaw=yaw, speed=0.3, yaw_rate=0.3)
        playback.observe(turning, t, t)
    playback.observe(AT_REST, 10.0, 10.0)
    playback.hear(ARMED, 10.0)
    playback.start(10.0)
    for t in np.arange(10.0, 11.0, 0.01):
        playback.observe(AT_REST, t, t)
        playback.hear(ARMED, t)
        command = playback.tick(t)
    assert playback.state is PlaybackState.RUNNING
    assert command.steering_motor_angle == pytest.approx(0.1)


def led_along(pose_at, until, lead_in=0.9):
    """A playback of a plan without an area; `pose_at` says where the vehicle is after its start."""
    playback = ready()
    playback.load(Schedule(np.array([0.0, 2.0]), np.array([0.1, 0.1]), np.array([1.0, 1.0])), 7)
    playback.parts.add_path(PATH, 7)
    playback.parts.add_area({"ground": ("", ())}, 7)
    playback.parts.add_lead_in(lead_in, 7)
    playback.start(10.0)
    for t in np.arange(10.0, 10.0 + PREPARATION + until, 0.01):
        since = 0.0 if playback.start_time is None else t - playback.start_time
        playback.observe(pose_at(since) if since else AT_REST, t, t)
        playback.hear(ARMED, t)
        playback.tick(t)
    return playback


def at_half_a_metre_per_second(since):
    return replace(AT_REST, y=AT_REST.y + 0.5 * since, speed=0.5)


def frozen(since):
    return at_half_a_metre_per_second(min(since, 0.2))


def jumped(since):
    moved = at_half_a_metre_per_second(since)
    return replace(moved, x=moved.x + 0.5 * (since > 0.2))


@pytest.mark.parametrize(
    ("pose_at", "reason", "in_open_loop"),
    [
        (frozen, "the pose has been the same for", PlaybackState.ABORTED),
        (jumped, r"the pose is 0\.50 m from where", PlaybackState.RUNNING),
    ],
)
def test_a_pose_that_freezes_or_jumps_ends_a_lead_in_without_an_area_too(
    pose_at, reason, in_open_loop
):
    playback = led_along(pose_at, 0.85)
    assert playback.state is PlaybackState.ABORTED
    assert re.search(reason, playback.reason)
    assert led_along(at_half_a_metre_per_second, 1.5).state is PlaybackState.RUNNING
    # open loop nothing is steered by it, but only a pose that changes shows a deviation
    assert led_along(pose_at, 1.5, lead_in=0.0).state is in_open_loop
    assert led_along(pose_at, 1.5, lead_in=0.15).state is in_open_loop


@pytest.mark.parametrize("end", [-0.1, np.nan, np.inf])
def test_a_lead_in_that_ends_at_no_time_is_refused(end):
    with pytest.raises(PlanError, match="needs a time from 0"):
        ready().parts.add_lead_in(end)


def played(way_at, speed_at, duration, *, latency=0.0, every=0.02):
    """Playback of a plan straight on, of a vehicle that has gone this way after some time."""
    time = np.arange(0.0, duration + 0.01, 0.02)
    playback = ready(max_deviation=3.0)
    rates = np.array([speed_at(t) for t in time]) / playback.chassis.tyre_radius
    playback.load(Schedule(time, np.zeros(time.size), rates))
    playback.parts.add_path(np.column_stack([np.arange(0.0, 40.0), np.zeros(40)]))
    start(playback, 10.0)
    now, rng = 10.0, np.random.default_rng(1)
    while playback.state is PlaybackState.RUNNING or playback.start_time is None:
        playback.hear(ARMED, now)
        if round((now - 10.0) / 0.01) % round(every / 0.01) == 0:
            x, y = 0.01 * rng.standard_normal(2)
            pose = replace(AT_REST, x=AT_REST.x + x, y=AT_REST.y + way_at(now - 10.0 - latency) + y)
            playback.observe(pose, now - latency, now)
        playback.tick(now)
        now += 0.01
    return playback, now - 10.0


ACCELERATED = partial(np.interp, xp=[0.0, 2.0], fp=[0.0, 2.0])
"""Speed of a vehicle that gets from rest to 2 m/s with 1 m/s^2."""


@pytest.mark.parametrize(
    ("way_at", "speed_at", "duration", "after"),
    [
        (lambda _t: 0.0, ACCELERATED, 9.0, 3.8),  # it never leaves its start
        (lambda _t: 0.0, ACCELERATED, 2.5, 2.5),  # nor does it in a short maneuver
        (lambda _t: 0.0, lambda _t: 0.1, 20.0, 10.0),
        (lambda t: min(max(0.0, 2.0 * (t - 1.0)), 4.0), ACCELERATED, 9.0, 6.2),  # stops half way
    ],
)
def test_a_vehicle_that_does_not_move_as_it_is_driven_has_not_driven_the_maneuver(
    way_at, speed_at, duration, after
):
    playback, ended = played(way_at, speed_at, duration)
    assert playback.state is PlaybackState.ABORTED
    assert re.search("commanded to go .* m on, but its pose has moved by", playback.reason)
    assert ended == pytest.approx(after, abs=0.3)


@pytest.mark.parametrize(
    ("way_at", "speed_at", "duration"),
    [
        (lambda t: max(0.0, 2.0 * (t - 1.0)), ACCELERATED, 9.0),
        (lambda t: 0.07 * max(0.0, t) ** 2, lambda _t: 4.0, 9.0),  # heavy, and uphill
        (lambda t: max(0.0, 2.0 * (t - 7.0)), lambda t: 2.0 * (t > 6.0), 9.0),  # stands at first
        (lambda t: 0.1 * max(0.0, t), lambda _t: 0.1, 20.0),
        (lambda t: 0.6 * math.sin(t), lambda t: 0.6 * math.cos(t), 20.0),  # there and back
    ],
)
@pytest.mark.parametrize(("latency", "every"), [(0.0, 0.02), (0.3, 0.1)])
def test_a_vehicle_that_moves_as_it_is_driven_however_slowly_has_driven_the_maneuver(
    way_at, speed_at, duration, latency, every
):
    playback, _ = played(way_at, speed_at, duration, latency=latency, every=every)
    assert (playback.state, playback.reason) == (PlaybackState.DONE, "")


def test_the_origin_of_the_path_is_where_the_vehicle_is_and_then_where_it_started():
    playback = ready()
    elsewhere = PlanarState(3.0, 2.0, 0.0, 0.0)
    playback.observe(elsewhere, 10.0, 10.0)
    assert playback.origin == elsewhere
    start(playback, 10.5)
    playback.observe(MOVING, 10.51, 10.51)
    playback.tick(10.51)
    assert playback.origin == AT_REST
    playback = Playback(VehicleWatch(odom_timeout=0.5), max_deviation=1.0)
    assert playback.origin is None
    playback.observe(PlanarState(math.nan, 0.0, 0.0, 0.0), 1.0, 1.0)
    assert playback.origin is None


def test_a_late_tick_plays_the_row_that_is_due():
    assert running().tick(10.03) == JointCommand(0.2, 2.0)


def test_after_a_run_standstill_is_commanded_until_the_vehicle_rests():
    playback = running()
    stop = playback.tick(10.05)
    for t in (10.1, 11.0, 12.0, 14.0):
        playback.observe(MOVING, t, t)
        assert playback.tick(t) == stop
    playback.observe(AT_REST, 14.1, 14.1)
    assert playback.tick(14.1) is None
    assert playback.state is PlaybackState.DONE


def test_a_vehicle_at_rest_hears_of_the_standstill_too():
    playback = running()
    playback.abort("asked for")
    for t in (10.1, 11.9):
        playback.observe(AT_REST, t, t)
        assert playback.tick(t) == STOP


def test_where_rest_is_not_known_standstill_is_commanded_for_five_seconds():
    playback = running()
    stop = playback.tick(10.05)
    assert playback.tick(15.0) == stop
    assert playback.tick(15.06) is None


def test_the_newest_commands_of_a_run_are_taken_after_it():
    playback = running()
    playback.load(schedule(), stamp=1, plan_id="older")
    playback.load(schedule(), stamp=2, plan_id="newest")
    playback.parts.add_path(PATH, stamp=2)
    assert (playback.state, playback.plan_id) == (PlaybackState.RUNNING, "")
    playback.tick(10.05)
    assert (playback.state, playback.plan_id) == (PlaybackState.DONE, "")
    with pytest.raises(PlanError, match="being stopped after a run"):
        playback.start(10.06)
    held = None
    for t in (10.2, 12.1):
        playback.observe(AT_REST, t, t)
        playback.hear(ARMED, t)
        held = playback.tick(t) or held
    assert (playback.state, playback.plan_id) == (PlaybackState.WAITING, "newest")
    playback.start(12.1)
    playback.abort("test")
    assert playback.tick(12.11).steering_motor_angle == held.steering_motor_angle != 0.0


def test_commands_that_come_while_the_vehicle_is_stopped_are_taken_when_it_rests():
    playback = running()
    playback.abort("asked for")
    playback.load(schedule(), plan_id="next")
    assert playback.state is PlaybackState.ABORTED
    for t in (10.1, 12.1):
        playback.observe(AT_REST, t, t)
        playback.tick(t)
    assert (playback.state, playback.plan_id) == (PlaybackState.WAITING, "next")


def without_commands():
    playback = Playback(VehicleWatch(odom_timeout=0.5), max_deviation=1.0)
    playback.observe(AT_REST, 10.0, 10.0)
    playback.hear(ARMED, 10.0)
    return playback


def without_path():
    playback = without_commands()
    playback.load(schedule())
    return playback


def with_another_path():
    playback = without_path()
    playback.parts.add_path(PATH, stamp=1)
    return playback


def without_readiness():
    playback = Playback(VehicleWatch(odom_timeout=0.5), max_deviation=1.0)
    playback.load(schedule())
    playback.parts.add_path(PATH)
    playback.observe(AT_REST, 10.0, 10.0)
    return playback


def hearing(readiness, at=10.0, **options):
    playback = ready(**options)
    playback.hear(readiness, at)
    return playback


def seeing(state, stamp=10.0, at=10.0):
    playback = ready()
    playback.observe(state, stamp, at)
    return playback


NOT_A_NUMBER = PlanarState(math.nan, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("prepare", "reason"),
    [
        (without_commands, "no commands yet"),
        (without_path, "no path on maneuver/path with the stamp of the commands"),
        (with_another_path, "no path on maneuver/path with the stamp of the commands"),
        (without_readiness, r"nothing heard on vehicle/state; is tricycle_bridge running\?"),
        (lambda: hearing(PRESSED), r"not armed: hardware e-stop pressed; arm it \(.*/arm\)"),
        (lambda: hearing(ARMED, at=8.9), r"nothing heard on vehicle/state for 1\.10 s"),
        (
            lambda: hearing(Readiness(armed=True, commander="/teleop"), commander="/driver"),
            r"the vehicle obeys another commander, /teleop: .* release",
        ),
        (lambda: seeing(AT_REST, stamp=9.0, at=9.0), r"no pose on odom for 1\.00 s"),
        (lambda: seeing(AT_REST, stamp=9.0), r"no pose on odom for 1\.00 s, by its stamp"),
        (lambda: seeing(AT_REST, stamp=15.0), r"stamped 5\.00 s ahead of the clock: synchronise"),
        (lambda: seeing(NOT_A_NUMBER), "the pose on odom is not finite"),
        (lambda: seeing(replace(AT_REST, body="imu_link")), "odom has the pose of imu_link"),
        (lambda: seeing(MOVING), r"moves at 0\.80 m/s"),
    ],
)
def test_start_is_refused_with_its_reason(prepare, reason):
    playback = prepare()
    with pytest.raises(PlanError, match=reason):
        playback.start(10.0)
    assert playback.state is PlaybackState.WAITING
    assert playback.tick(10.01) is None


def test_the_preflight_says_how_everything_stands_that_a_start_needs():
    playback = fenced()
    for k in range(20):
        playback.observe(replace(AT_REST_IN_ODOM, x=1.0 + 0.004 * (-1) ** k), 9.0 + 0.05 * k, 10.0)
    playback.observe(AT_REST_IN_ODOM, 10.0, 10.0)
    items = {item.name: item for item in playback.preflight(10.03)}
    assert all(item.level is Level.OK for item in items.values())
    assert re.fullmatch(
        r"20 Hz, 0\.03 s old, scatters by 4 mm and 0\.0 deg", items["localisation"].message
    )
    assert items["ground"].message == "fenced in odom"
    playback.observe(replace(AT_REST_IN_ODOM, x=1.2), 10.04, 10.04)
    playback.hear(PRESSED, 10.04)
    failing = {i.name: i.message for i in playback.preflight(10.05) if i.level is Level.ERROR}
    assert sorted(failing) == ["start", "vehicle"]
    with pytest.raises(PlanError, match=r"the vehicle is not armed"):  # the first one
        playback.start(10.05)


def test_without_anything_the_preflight_says_what_is_missing():
    items = Playback(VehicleWatch(odom_timeout=0.5), max_deviation=1.0).preflight(10.0)
    assert [i.name for i in items if i.level is Level.ERROR] == [
        "plan", "vehicle", "localisation", "standstill"
    ]  # fmt: skip
    assert "no speed on odom; it must stand still" in {i.message for i in items}


def test_a_pose_that_jumps_at_rest_refuses_the_start_until_it_has_stayed_for_a_second():
    playback = ready()
    playback.parts.add_area({"ground": ("", ())})
    away = replace(AT_REST, x=3.0)
    playback.observe(away, 10.05, 10.05)
    with pytest.raises(PlanError, match=r"the pose is 2\.00 m from where"):
        playback.start(10.1)
    for k in range(25):
        playback.observe(away, 10.1 + 0.05 * k, 10.1 + 0.05 * k)
        playback.hear(ARMED, 10.1 + 0.05 * k)
    playback.start(11.31)


def test_one_stamp_ahead_does_not_hide_a_jump_at_rest():
    playback = ready()
    playback.observe(AT_REST, 60.0, 10.05)
    playback.observe(replace(AT_REST, x=3.0), 10.1, 10.1)
    with pytest.raises(PlanError, match=r"the pose is 2\.00 m from where"):
        playback.start(10.1)


def test_stamps_of_a_clock_that_was_set_back_begin_anew():
    playback = ready()
    for t in (5.0, 5.05):
        playback.observe(AT_REST, t, t)
    playback.hear(ARMED, 5.1)
    playback.observe(replace(AT_REST, x=3.0), 5.1, 5.1)
    with pytest.raises(PlanError, match=r"the pose is 2\.00 m from where"):
        playback.start(5.1)


def test_a_message_that_is_repeated_does_not_hide_a_jump_at_rest():
    playback = ready()
    away = replace(AT_REST, x=3.0)
    for received in (10.05, 10.06, 10.07):
        playback.observe(away, 10.05, received)
    with pytest.raises(PlanError, match=r"the pose is 2\.00 m from where"):
        playback.start(10.1)


def test_a_check_of_another_node_refuses_the_start_with_its_name():
    playback = ready()
    with pytest.raises(PlanError, match="bag: not recording"):
        playback.start(10.0, [Check("bag", "not recording", Level.ERROR)])
    playback.start(10.0, [Check("bag", "not recording", Level.WARN)])


def test_a_check_of_another_node_refuses_the_way_back_with_its_name():
    playback = fenced()
    with pytest.raises(PlanError, match="bag: not recording"):
        playback.go_back(10.0, [Check("bag", "not recording", Level.ERROR)])
    assert playback.state is PlaybackState.WAITING
    playback.go_back(10.0, [Check("bag", "not recording", Level.WARN)])


def test_a_running_maneuver_refuses_a_start():
    with pytest.raises(PlanError, match=r"already running: .*~/abort"):
        running().start(10.0)


def test_abort_stops_the_vehicle_until_it_is_disarmed_and_says_why():
    playback = running()
    playback.abort("asked for")
    assert playback.tick(10.02) == STOP
    playback.hear(PRESSED, 10.03)
    assert playback.tick(10.03) == JointCommand(0.1, 0.0)
    playback.hear(ARMED, 11.0)  # by the operator, who is not stopped again
    assert playback.tick(11.0) == JointCommand(0.1, 0.0)
    assert (playback.state, playback.reason) == (PlaybackState.ABORTED, "asked for")
    with pytest.raises(PlanError, match="no maneuver is running"):
        playback.abort("again")


def test_a_maneuver_that_is_ended_early_is_done_with_a_reason():
    playback = running()
    playback.finish("ended early")
    assert playback.state is PlaybackState.RUNNING  # until the next tick
    assert playback.tick(10.02) == JointCommand(0.1, 0.0)
    assert (playback.state, playback.reason) == (PlaybackState.DONE, "ended early")
    assert playback.elapsed == pytest.approx(0.02)
    with pytest.raises(PlanError, match="no maneuver is running"):
        playback.finish("again")
    for t in (11.0, 13.0):  # at rest
        playback.observe(AT_REST, t, t)
        playback.tick(t)
    start(playback, 14.0)  # the next one is not ended by it
    assert playback.tick(14.0) == JointCommand(0.1, 1.0)
    assert (playback.state, playback.reason) == (PlaybackState.RUNNING, "")


def test_a_maneuver_at_its_last_command_is_not_ended_early():
    playback = running()
    playback.finish("ended early")
    playback.tick(10.05)
    assert (playback.state, playback.reason) == (PlaybackState.DONE, "")


def test_a_vehicle_that_disarms_aborts_at_once_even_if_it_is_armed_again_before_the_next_tick():
    playback = running()
    playback.hear(PRESSED, 10.011)
    playback.hear(ARMED, 10.012)
    assert playback.tick(10.02) == JointCommand(0.1, 0.0)
    assert playback.state is PlaybackState.ABORTED
    assert playback.reason == "the vehicle is not armed: hardware e-stop pressed"


LONG = Schedule(np.array([0.0, 60.0]), np.zeros(2), np.ones(2))


@pytest.mark.parametrize(
    ("silent", "reason", "after"),
    [
        ("vehicle", "nothing heard on vehicle/state for 1.01 s", 1.01),
        ("pose", "no pose on odom for 0.51 s", 0.51),
        ("clock of the pose", "no pose on odom for 0.51 s, by its stamp", 0.51),
    ],
)
def test_silence_aborts(silent, reason, after):
    playback = ready()
    playback.load(LONG)
    playback.start(10.0)
    t = 10.0
    while playback.state is not PlaybackState.ABORTED and t < 20.0:
        t += 0.01
        if silent != "vehicle":
            playback.hear(ARMED, t)
        if silent != "pose":
            playback.observe(AT_REST, 10.0 if silent == "clock of the pose" else t, t)
        playback.tick(t)
    assert (playback.reason, t) == (reason, pytest.approx(10.0 + after))


@pytest.mark.parametrize(
    ("state", "stamp", "reason"),
    [
        (NOT_A_NUMBER, 10.01, "is not finite"),
        (PlanarState(1.0, 2.0, math.inf, 0.0), 10.01, "is not finite"),
        (AT_REST, 15.0, "4.98 s ahead of the clock"),
        (PlanarState(1e300, -1e300, 0.0, 0.0), 10.01, "m off the path"),
        (replace(AT_REST, speed=1e300), 10.01, "odom says 1e+300 m/s"),
        (replace(AT_REST, yaw_rate=-50.0), 10.01, "odom says a turn rate of -50 rad/s"),
    ],
)
def test_a_pose_that_is_none_aborts(state, stamp, reason):
    playback = running()
    playback.observe(state, stamp, 10.01)
    playback.tick(10.02)
    assert playback.state is PlaybackState.ABORTED
    assert reason in playback.reason


def test_another_commander_aborts():
    playback = running(commander="/driver")
    playback.hear(Readiness(armed=True, commander="/driver"), 10.01)
    playback.tick(10.01)
    assert playback.state is PlaybackState.RUNNING
    playback.hear(Readiness(armed=True, commander="/teleop"), 10.02)
    playback.tick(10.02)
    assert playback.reason.startswith("the vehicle obeys another commander, /teleop: end it")


def test_a_vehicle_that_refuses_commands_aborts_at_once_even_if_it_obeys_the_next_one():
    playback = running()
    playback.hear(Readiness(True, refused="speed 2 m/s: at most 1.5 m/s"), 10.01)
    playback.hear(ARMED, 10.01)
    assert playback.tick(10.02) == STOP
    reason = "tricycle_bridge refuses the commands: speed 2 m/s: at most 1.5 m/s"
    assert (playback.state, playback.reason) == (PlaybackState.ABORTED, reason)


def test_a_driver_or_a_clock_that_leaves_out_commands_aborts():
    playback = running()
    playback.tick(10.01)
    assert playback.state is PlaybackState.RUNNING
    assert playback.tick(10.13) == STOP
    assert playback.state is PlaybackState.ABORTED
    assert playback.reason.startswith("for 0.12 s no command was sent")


def test_a_driver_that_is_held_up_while_the_clock_is_set_back_aborts():
    playback = running()
    assert playback.tick(10.01, 0.12) == STOP
    assert playback.reason.startswith("for 0.12 s no command was sent")


def test_a_clock_that_jumps_back_aborts_and_makes_what_was_heard_unknown():
    playback = running()
    assert playback.tick(7.0) == STOP
    assert playback.reason == "the clock jumped back by 3.00 s"
    assert playback.tick(11.9) == STOP
    assert playback.tick(12.1) is None
    with pytest.raises(PlanError, match="nothing heard on vehicle/state"):
        playback.start(12.1)


def test_a_clock_that_jumps_back_makes_the_button_unknown():
    playback = ready(hold_timeout=0.2)
    playback.hold(pressed=True, now=10.0)
    playback.tick(10.0)
    playback.tick(7.0)
    playback.observe(AT_REST, 7.1, 7.1)
    playback.hear(ARMED, 7.1)
    with pytest.raises(PlanError, match="maneuver/hold is not pressed"):
        playback.start(7.1)


def test_a_small_step_back_of_the_clock_plays_the_first_row_again():
    assert running().tick(9.95) == JointCommand(0.1, 1.0)


def test_leaving_the_path_aborts_wherever_the_start_was():
    playback = running()
    along = PlanarState(1.0, 4.0, 0, 1)  # 2 m along the path, which points along +y
    playback.observe(along, 10.01, 10.01)
    playback.tick(10.01)
    assert playback.state is PlaybackState.RUNNING
    left = PlanarState(-0.5, 4.0, 0, 1)  # 1.5 m to the left of it
    playback.observe(left, 10.02, 10.02)
    playback.tick(10.02)
    assert playback.reason == "1.50 m off the path (limit 1 m)"


def test_any_point_of_a_long_path_is_near_enough():
    playback = ready()
    length = 0.02 * np.arange(100_000.0)  # out and back
    playback.parts.add_path(np.column_stack([1000.0 - abs(1000.0 - length), np.zeros(100_000)]))
    playback.load(LONG)
    start(playback, 9.99)
    playback.tick(9.99)
    for tick, along in enumerate((0.0, 500.0, 5.0, 1000.0)):
        t = 10.0 + 0.01 * tick
        playback.observe(PlanarState(1.0, 2.0 + along, np.pi / 2, 1.0), t, t)
        playback.tick(t)
        assert playback.state is PlaybackState.RUNNING
    playback.observe(PlanarState(1.0, 1003.5, np.pi / 2, 1.0), 10.05, 10.05)
    playback.tick(10.05)
    assert playback.reason == "1.50 m off the path (limit 1 m)"


def test_the_path_is_that_of_the_commands_whatever_other_plans_are_published():
    own, other = PATH, np.array([[9.0, 9.0], [9.0, 8.0]])
    playback = ready()
    playback.parts.add_path(other, stamp=1)
    playback.load(schedule(), stamp=2)
    with pytest.raises(PlanError, match="no path on maneuver/path with the stamp"):
        playback.start(10.0)
    playback.parts.add_path(own, stamp=2)
    playback.parts.add_path(other, stamp=3)
    start(playback, 10.0)
    playback.parts.add_path(other, stamp=2)
    playback.tick(10.0)
    assert playback.state is PlaybackState.RUNNING


@pytest.mark.parametrize(
    ("time", "angle", "rate", "message"),
    [
        ([0.0, 0.0], [0.0, 0.0], [0, 0], "row 1: time 0 s does not come after 0 s"),
        ([0.0, 0.2, 0.1], [0.0] * 3, [0] * 3, r"row 2: time 0\.1 s does not come after 0\.2 s"),
        ([0.1, 0.2], [0.0, 0.0], [0, 0], "the first row is due at 0 s"),
        ([0.0], [0.0], [0], "1 rows; needs 2 to"),
        ([], [], [], "0 rows; needs 2 to"),
        (range(MAX_ROWS + 1), [], [], f"{MAX_ROWS + 1} rows; needs 2 to {MAX_ROWS}"),
        ([0.0, 0.1], [0.0, math.nan], [0, 0], "row 1: steering motor angle nan: needs a number"),
        ([0.0, 0.1], [0.0, 0.8], [0, 0], r"row 1: steering motor angle 0\.8: needs .* rad of 0"),
        ([0.0, 0.1], [0.0, 0.0], [1e300, 0], r"row 0: wheel rate 1e\+300: needs .* rad/s of 0"),
        ([0.0, math.inf], [0.0, 0.0], [0, 0], "row 1: time inf: needs"),
        ([0.0, 1e300], [0.0, 0.0], [0, 0], r"row 1: time 1e\+300: needs"),
        ([0.0, 1.0], [0.0], [0, 0], "steering motor angle: needs one number for each"),
    ],
)
def test_a_schedule_is_checked(time, angle, rate, message):
    with pytest.raises(PlanError, match=message):
        Schedule(*(np.array(column, dtype=float) for column in (time, angle, rate)))


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.empty((0, 2)), "0 points; needs 2"),
        (np.zeros((1, 2)), "1 points; needs 2"),
        (np.zeros((MAX_ROWS + 1, 2)), "points; needs 2 to"),
        (np.array([[0.0, 0.0], [math.nan, 0.0]]), "point 1 holds a number that is not finite"),
        (np.array([[math.inf, 0.0], [0.0, 0.0]]), "point 0 holds a number that is not finite"),
    ],
)
def test_a_path_is_checked_and_none_means_no_start(points, message):
    playback = without_path()
    with pytest.raises(PlanError, match=message):
        playback.parts.add_path(points)
    with pytest.raises(PlanError, match="no path"):
        playback.start(10.0)


numbers = st.sampled_from([0.0, 1.0, 2.0]) | st.floats()
states = st.just(AT_REST) | st.builds(PlanarState, *[numbers] * 4)
events = st.one_of(
    st.just(("nothing",)),
    st.just(("start",)),
    st.tuples(st.just("hear"), st.booleans()),
    st.tuples(st.just("observe"), states, st.sampled_from([0.0, 0.0, 0.2, 9.0, -9.0])),
)


@pytest.mark.slow
@given(st.lists(events, min_size=12, max_size=40))
def test_it_moves_only_an_armed_vehicle_whose_pose_is_a_number(events):
    playback = ready(odom_timeout=5.0)
    playback.load(LONG)
    playback.start(10.0)
    armed, seen = True, True
    for tick, (event, *content) in enumerate(events):
        now = 10.0 + 0.05 * tick
        if event == "observe":
            state, ahead = content
            playback.observe(state, now + ahead, now)
            seen = state.finite and abs(ahead) < 5.0
        elif event == "start":
            with suppress(PlanError):
                playback.start(now)
        else:
            armed = content[0] if content else armed
            playback.hear(Readiness(armed), now)
        command = playback.tick(now)
        if command is not None and command.wheel_rate != 0.0:
            assert armed
            assert seen


YARD = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 9.0], [0.0, 9.0]])
BODY = np.array([[0.5, 0.3], [-0.5, 0.3], [-0.5, -0.3], [0.5, -0.3]])
AT_REST_IN_ODOM = replace(AT_REST, frame="odom")
PARTS = {
    "ground": ("odom", (YARD,)),
    "footprint": BODY,
    "planned_start": (1.0, 2.0, np.pi / 2),
    "twist": np.zeros(3),
}


def fenced(now=10.0, **parts):
    """A playback on an area, 0.5 s before row 0; `None` leaves a part out."""
    playback = ready(now)
    come = {part: value for part, value in (PARTS | parts).items() if value is not None}
    playback.parts.add_area(come)
    playback.observe(AT_REST_IN_ODOM, now, now)
    return playback


@pytest.mark.parametrize(
    ("parts", "refusal"),
    [
        ({"footprint": None}, "nothing on maneuver/footprint with the stamp of the commands"),
        ({"twist": np.zeros(2)}, "2 rows on maneuver/twist; the commands have 3"),
        ({"ground": ("map", (YARD,))}, "the area is in frame 'map', the pose on odom in 'odom'"),
        ({"ground": ("odom", (YARD + 1.0,))}, "fence: 0.30 m out of the area"),
        ({"planned_start": (1.0, 2.4, np.pi / 2)}, "0.40 m back and 0.00 m"),
    ],
)
def test_what_would_not_stay_on_its_area_is_not_started(parts, refusal):
    playback = fenced(**parts)
    with pytest.raises(PlanError, match=re.escape(refusal)):
        playback.start(10.0)
    assert playback.state is PlaybackState.WAITING


def test_an_area_of_another_stamp_means_no_start_and_an_empty_one_no_fence():
    playback = ready()
    playback.parts.add_area({"ground": ("odom", (YARD,))}, stamp=1)
    with pytest.raises(PlanError, match="nothing on maneuver/ground with the stamp"):
        playback.start(10.0)
    playback = ready()
    playback.parts.add_area({"ground": ("", ())})
    playback.start(10.0)
    assert not playback.fenced


def test_a_plan_whose_ground_is_still_on_its_way_is_not_started_without_it():
    playback = ready(ground_needed=True)
    with pytest.raises(PlanError, match=r"nothing on maneuver/ground .* or set unfenced_plans"):
        playback.start(10.0)
    playback.parts.add_area({"ground": ("", ())})
    playback.start(10.0)
    assert not playback.fenced


@pytest.mark.parametrize(
    ("pose", "reason"),
    [
        (PlanarState(1.0, 2.01, np.pi / 2, 4.0, frame="odom"), "fence: would come"),
        (PlanarState(1.0, 4.0, np.pi / 2, 0.5, frame="odom"), "velocity led in"),
        (PlanarState(1.0, 2.01, np.pi / 2, 0.1, yaw_rate=math.nan, frame="odom"), "no turn rate"),
    ],
)
def test_the_fence_and_a_pose_that_jumps_abort(pose, reason):
    playback = fenced()
    playback.max_deviation = 10.0
    playback.start(10.0)
    assert playback.fenced
    playback.observe(AT_REST_IN_ODOM, 10.005, 10.005)
    assert playback.tick(10.01) is not None
    playback.observe(pose, 10.02, 10.02)
    assert playback.tick(10.02) == JointCommand(0.1, 0.0)  # the wheels were not to turn yet
    assert playback.state is PlaybackState.ABORTED
    assert reason in playback.reason


IMPLAUSIBLE = [
    (replace(AT_REST_IN_ODOM, speed=1e3, yaw_rate=1.0), "odom says 1000 m/s"),
    (replace(AT_REST_IN_ODOM, speed=1e6, yaw_rate=1.0), "odom says 1e+06 m/s"),
    (replace(AT_REST_IN_ODOM, speed=1e200), "odom says 1e+200 m/s"),
    (replace(AT_REST_IN_ODOM, yaw_rate=1e308), "odom says a turn rate of 1e+308 rad/s"),
]


@pytest.mark.parametrize(("state", "reason"), IMPLAUSIBLE)
def test_a_motion_that_no_vehicle_has_fails_the_pre_flight_and_ends_a_run(state, reason):
    playback = fenced(9.5)
    playback.observe(state, 9.51, 9.51)
    failing = {i.name: i.message for i in playback.preflight(9.51) if i.level is Level.ERROR}
    assert failing.keys() <= {"localisation", "standstill"}
    assert reason in failing["localisation"]
    with pytest.raises(PlanError, match=re.escape(reason)):
        playback.start(9.51)
    playback.observe(AT_REST_IN_ODOM, 9.52, 9.52)
    playback.start(9.52)
    playback.observe(state, 9.53, 9.53)
    playback.tick(9.53)
    assert playback.state is PlaybackState.ABORTED
    assert reason in playback.reason


@pytest.mark.parametrize(("state", "reason"), IMPLAUSIBLE)
def test_a_motion_that_no_vehicle_has_stops_the_one_that_rolls_out_on_its_area(state, reason):
    playback = fenced(9.5)
    playback.start(9.5)
    for t in (10.0, 10.05):
        playback.observe(AT_REST_IN_ODOM, t, t)
        assert playback.tick(t) is not None
    assert playback.tick(10.06) == JointCommand(0.3, 0.0)
    playback.observe(state, 10.07, 10.07)
    assert playback.tick(10.07) == JointCommand(0.3, 0.0, stop=True)
    assert playback.state is PlaybackState.DONE


def test_nothing_is_commanded_during_the_countdown():
    playback = ready(countdown=2.0)
    playback.start(10.0)
    left = []
    for t in (10.0, 10.9, 11.1, 11.9, 12.1, 12.5):
        playback.observe(AT_REST, t, t)
        playback.hear(ARMED, t)
        left.append((playback.tick(t), playback.seconds_left))
    assert left[:4] == [(None, 2), (None, 2), (None, 1), (None, 1)]
    assert left[4:] == [(JointCommand(0.1, 0.0), 0), (JointCommand(0.1, 1.0), 0)]
    assert playback.start_time == 12.5


def counted_down(pose_at):
    """A playback whose countdown of 3 s has ended; `pose_at` says where the vehicle was."""
    playback = ready(countdown=3.0)
    playback.start(10.0)
    for k in range(71):
        t = 10.0 + 0.05 * k
        playback.observe(pose_at(t - 10.0), t, t)
        playback.hear(ARMED, t)
        command = playback.tick(t)
    return playback, command


@pytest.mark.parametrize(
    ("pose_at", "reason"),
    [
        (lambda t: replace(AT_REST, y=2.0 + 0.04 * t, speed=0.04), r"moved .* by 0\.10 m and 0\.0"),
        (lambda t: replace(AT_REST, yaw=1.57 + 0.05 * (t > 2.0)), r"moved .* by 0\.00 m and 2\.9"),
    ],
)
def test_a_vehicle_that_was_moved_during_the_countdown_is_not_driven(pose_at, reason):
    playback, command = counted_down(pose_at)
    assert playback.state is PlaybackState.ABORTED
    assert re.search(reason, playback.reason)
    assert command == JointCommand(0.1, 0.0)


def turning_in(until, speed, angle_at, countdown=0.0):
    """A playback and its ticks while the wheels turn to the first row's angle, 0.1 rad."""
    playback, played = ready(countdown=countdown), []
    playback.start(10.0)
    for t in np.arange(10.0, until, 0.01):
        playback.observe(replace(AT_REST, speed=speed(t - 10.0)), t, t)
        playback.hear(ARMED, t)
        playback.watch.steer(angle_at(t - 10.0), t)
        played.append(playback.tick(t))
        if playback.state is PlaybackState.RUNNING:
            break
    return playback, played


def test_row_0_waits_until_the_wheels_are_at_its_angle_and_the_vehicle_rests():
    def angle(t):  # lock to lock
        return max(0.1, 0.7 - max(t - 0.1, 0.0))

    playback, _ = turning_in(12.0, lambda _: 0.0, angle)
    assert playback.start_time == pytest.approx(10.65, abs=0.02)  # within 0.05 rad
    playback, played = turning_in(12.0, lambda t: 0.1 * (t < 1.2), angle)
    assert playback.start_time == pytest.approx(11.2, abs=0.02)
    assert set(played[:-1]) == {JointCommand(0.1, 0.0)}


@pytest.mark.parametrize(
    ("speed", "angle", "reason"),
    [
        (0.0, 0.4, r"the steering motor is at 0\.40 rad, the plan begins at 0\.10 rad"),
        (0.3, 0.1, r"the vehicle moves at 0\.30 m/s; it must stand still"),
    ],
)
def test_wheels_that_do_not_arrive_and_a_vehicle_that_does_not_rest_end_the_start(
    speed, angle, reason
):
    playback, _ = turning_in(
        10.0 + PREPARATION + ARRIVAL - 0.1, lambda t: speed * (t > 0), lambda _: angle
    )
    assert playback.state is PlaybackState.STARTING
    playback, played = turning_in(
        10.0 + PREPARATION + ARRIVAL + 0.1, lambda t: speed * (t > 0), lambda _: angle
    )
    assert playback.state is PlaybackState.ABORTED
    assert re.search(reason, playback.reason)
    assert {command.wheel_rate for command in played} == {0.0}


def test_a_steering_that_stays_beside_its_set_point_and_one_that_is_not_measured_are_driven():
    playback, _ = turning_in(22.0, lambda _: 0.0, lambda _: 0.2)  # no fault of the steer board
    assert playback.start_time == pytest.approx(10.0 + PREPARATION + ARRIVAL, abs=0.02)
    playback, _ = turning_in(12.0, lambda _: 0.0, lambda _: math.nan)
    assert playback.start_time == pytest.approx(10.0 + PREPARATION, abs=0.02)


def test_a_vehicle_that_was_moved_off_the_planned_start_is_not_driven():
    """By less than the tolerance since it was asked to start, by more since the plan."""
    playback = fenced()
    playback.countdown = 3.0
    playback.start(10.0)
    for k in range(80):
        t = 10.0 + 0.05 * k
        y = AT_REST_IN_ODOM.y + 0.045 + 0.045 * min(t - 10.0, 2.0) / 2.0
        playback.observe(replace(AT_REST_IN_ODOM, y=y), t, t)
        playback.hear(ARMED, t)
        playback.tick(t)
    assert playback.state is PlaybackState.ABORTED
    assert "of the planned start" in playback.reason


def test_a_noisy_pose_is_no_motion_during_the_countdown():
    signs = itertools.cycle((1.0, -1.0))
    playback, _ = counted_down(
        lambda _: replace(AT_REST, x=1.0 + 0.08 * (s := next(signs)), yaw=1.57 + 0.03 * s)
    )
    assert playback.state is PlaybackState.RUNNING


def test_hold_to_run_released_or_silent_ends_the_run_and_is_needed_to_start():
    playback = ready(hold_timeout=0.2)
    with pytest.raises(PlanError, match="maneuver/hold is not pressed"):
        playback.start(10.0)
    playback.hold(pressed=True, now=10.0)
    playback.start(10.0)
    assert playback.tick(10.1) == JointCommand(0.1, 0.0)
    playback.hold(pressed=False, now=10.15)
    assert (playback.state, playback.reason) == (
        PlaybackState.ABORTED,
        "maneuver/hold is not pressed",
    )
    playback = ready(hold_timeout=0.2)
    playback.hold(pressed=True, now=10.0)
    with pytest.raises(PlanError, match="nothing heard on maneuver/hold"):
        playback.start(10.3)
    playback.start(10.1)
    playback.tick(10.21)
    assert playback.reason == "nothing heard on maneuver/hold for 0.21 s"


def rolling_out(**options):
    """A playback whose maneuver is done at t = 10.05; the vehicle still does 2 m/s."""
    playback = ready(**options)
    playback.hold(pressed=True, now=9.5)
    start(playback, 10.0)
    playback.hold(pressed=True, now=10.0)
    playback.tick(10.0)
    playback.observe(replace(AT_REST, speed=2.0), 10.05, 10.05)
    assert playback.tick(10.05) == JointCommand(0.3, 0.0)
    assert playback.state is PlaybackState.DONE
    return playback


STOPPED = JointCommand(0.3, 0.0, stop=True)


def test_a_button_that_is_released_while_the_vehicle_rolls_out_stops_it():
    playback = rolling_out(hold_timeout=0.2)
    playback.hold(pressed=False, now=10.06)
    assert playback.tick(10.06) == STOPPED
    playback.hold(pressed=True, now=10.07)
    assert playback.tick(10.07) == STOPPED
    assert (playback.state, playback.reason) == (PlaybackState.DONE, "")
    playback.hear(PRESSED, 10.08)  # the boards have stopped it
    assert playback.tick(10.08) == JointCommand(0.3, 0.0)
    playback.hold(pressed=False, now=10.09)
    assert playback.tick(10.09) == JointCommand(0.3, 0.0)


def test_a_button_that_falls_silent_while_the_vehicle_rolls_out_stops_it():
    playback = rolling_out(hold_timeout=0.2)
    playback.hold(pressed=True, now=10.06)
    assert playback.tick(10.25) == JointCommand(0.3, 0.0)
    assert playback.tick(10.27) == STOPPED


def test_an_abort_while_the_vehicle_rolls_out_stops_it_and_at_rest_is_refused():
    playback = rolling_out()
    playback.abort("asked for")
    assert playback.tick(10.06) == STOPPED
    assert (playback.state, playback.reason) == (PlaybackState.DONE, "")
    playback = rolling_out()
    playback.observe(NOT_A_NUMBER, 10.06, 10.06)  # nobody knows whether it rests
    playback.abort("asked for")
    assert playback.tick(10.07) == STOPPED
    playback = rolling_out()
    playback.observe(AT_REST, 10.06, 10.06)
    with pytest.raises(PlanError, match="no maneuver is running"):
        playback.abort("asked for")
    assert playback.tick(10.07) == JointCommand(0.3, 0.0)


def test_a_vehicle_that_is_ended_early_at_speed_is_stopped_by_an_abort_too():
    playback = running()
    playback.observe(MOVING, 10.01, 10.01)
    playback.finish("ended early")
    assert playback.tick(10.02) == JointCommand(0.1, 0.0)
    playback.abort("asked for")
    assert playback.tick(10.03) == STOP
    assert (playback.state, playback.reason) == (PlaybackState.DONE, "ended early")


def test_a_button_that_is_released_at_rest_after_a_run_stops_nothing():
    playback = rolling_out(hold_timeout=0.2)
    playback.observe(AT_REST, 10.06, 10.06)
    playback.hold(pressed=False, now=10.07)
    assert playback.tick(10.07) == JointCommand(0.3, 0.0)


def returning(now=10.0):
    """A playback that has driven, stands 1 m ahead of its start, and is asked to go back."""
    playback = running(now)
    there = replace(AT_REST_IN_ODOM, y=AT_REST.y + 1.0)
    for t in np.arange(now, now + 4.0, 0.1):
        way = min(max(0.0, t - now - 0.1), 1.0)  # at 1 m/s
        rolls = replace(there, y=AT_REST.y + way, speed=float(0.0 < way < 1.0))
        playback.observe(rolls, t, t)
        playback.hear(ARMED, t)
        playback.tick(t)
    assert playback.state is PlaybackState.DONE
    playback.go_back(t)
    return playback, there, float(t)


def test_the_way_back_leads_to_where_the_run_began():
    playback, there, now = returning()
    assert playback.state is PlaybackState.RETURNING
    with pytest.raises(PlanError, match=r"already running: .*~/abort"):
        playback.start(now)
    while playback.route_wanted is None:
        now += 0.1
        playback.observe(there, now, now)
        playback.hear(ARMED, now)
        assert playback.tick(now).wheel_rate == 0.0
    wanted, chassis = playback.route_wanted, playback.chassis
    np.testing.assert_allclose(wanted.start, chassis.axle(there.x, there.y, there.yaw))
    np.testing.assert_allclose(wanted.goal, chassis.axle(AT_REST.x, AT_REST.y, AT_REST.yaw))
    playback.follow((Arc(wanted.start, 0.0, -1.0),))
    now, pose = backwards(playback, there, now)
    assert pose.y < there.y - 0.3
    playback.hear(PRESSED, now)
    assert playback.state is PlaybackState.ABORTED
    assert playback.tick(now).wheel_rate == 0.0
    assert playback.route_wanted is None


def backwards(playback, pose, now):
    """Time and pose after 3 s in which the vehicle, heading +y, does what it is told."""
    end = now + 3.0
    while now < end and playback.state is PlaybackState.RETURNING:
        now += 0.01
        command = playback.tick(now)
        speed = command.wheel_rate * playback.chassis.tyre_radius
        slip = np.pi if speed < 0.0 else 0.0
        pose = replace(pose, y=pose.y + 0.01 * speed, speed=abs(speed), slip=slip)
        playback.observe(pose, now, now)
        playback.hear(ARMED, now)
        if playback.watch.hold_timeout:
            playback.hold(True, now)
    return now, pose


@pytest.mark.parametrize(
    ("fault", "reason"),
    [
        (
            lambda p, pose, t: p.observe(replace(pose, y=pose.y - 0.4), t + 0.01, t + 0.01),
            r"the pose is 0\.40 m from where",
        ),
        (lambda p, pose, t: p.observe(replace(pose, x=math.nan), t, t), "not finite"),
        (lambda p, pose, t: p.observe(replace(pose, yaw_rate=math.nan), t, t), "has no turn rate"),
        (lambda p, pose, t: [p.hear(ARMED, t + 0.6), p.tick(t + 0.6)], r"no pose on odom for 0\.6"),
        (
            lambda p, pose, t: [
                [p.hear(ARMED, t + d), p.observe(pose, t + d, t + d), p.tick(t + d)]
                for d in np.arange(0.05, 0.7, 0.05)
            ],
            "the pose has been the same for",
        ),
        (lambda p, pose, t: p.hold(False, t), "maneuver/hold is not pressed"),
        (lambda p, pose, t: p.abort("asked for"), "asked for"),
        (lambda p, pose, t: p.tick(t - 1.0), "the clock jumped back"),
    ],
)
def test_what_ends_a_run_ends_the_way_back_too(fault, reason):
    playback, there, now = returning()
    playback.watch.hold_timeout = 1.0
    playback.hold(True, now)
    while playback.route_wanted is None:
        now, _ = backwards(playback, there, now)
    playback.follow((Arc(playback.route_wanted.start, 0.0, -1.0),))
    now, pose = backwards(playback, there, now)
    assert pose.speed > 0.1
    fault(playback, pose, now)
    command = playback.tick(now + 0.01)
    assert playback.state is PlaybackState.ABORTED
    assert re.search(reason, playback.reason)
    assert command.wheel_rate == 0.0


@pytest.mark.parametrize("speed", [0.06, 0.04])  # every fourth one, when it is to stand
def test_a_way_back_on_which_the_vehicle_never_rests_ends(speed):
    playback, there, now = returning()
    began, moves = now, replace(there, speed=speed, yaw=there.yaw)
    for n in range(400):
        now += 0.1
        noise = 1e-4 * (n % 2)
        playback.observe(replace(there if n % 4 else moves, x=there.x + noise), now, now)
        playback.hear(ARMED, now)
        playback.tick(now)
        if playback.state is not PlaybackState.RETURNING:
            break
    if speed > 0.05:
        assert playback.state is PlaybackState.ABORTED
        assert re.search("to stand still, but .* by hand", playback.reason)
        assert now - began == pytest.approx(20.0, abs=1.0)
    else:  # a search for a route takes its time
        assert playback.route_wanted is not None


def test_without_a_turn_rate_there_is_no_way_back():
    playback = fenced()
    playback.observe(replace(AT_REST_IN_ODOM, yaw_rate=math.nan), 10.0, 10.0)
    with pytest.raises(PlanError, match="odom has no turn rate"):
        playback.go_back(10.0)
    assert playback.state is PlaybackState.WAITING


def test_the_way_back_stops_before_it_leads_off_the_area():
    playback = fenced()
    playback.start(10.0)
    playback.abort("asked for")
    there = replace(AT_REST_IN_ODOM, y=3.0)
    for t in np.arange(10.0, 16.0, 0.1):
        playback.observe(there, t, t)
        playback.hear(ARMED, t)
        playback.tick(t)
    playback.go_back(t)
    while playback.route_wanted is None:
        t, _ = backwards(playback, there, t)
    assert playback.fenced
    assert playback.route_wanted.ground
    far = Arc(playback.route_wanted.start, 0.0, -9.0)  # a wrong route, beyond y = 0
    playback.follow((far,))
    pose = there
    for _ in range(10):
        t, pose = backwards(playback, pose, t)
    assert playback.state is PlaybackState.ABORTED
    assert playback.reason.startswith("fence: ")
    assert pose.y + BODY[:, 0].min() > 0.0


def test_who_is_back_already_waits_for_the_next_start():
    playback, _, now = returning()
    for t in np.arange(now, now + 1.0, 0.1):
        playback.observe(AT_REST, t, t)
        playback.hear(ARMED, t)
        playback.tick(t)
    assert (playback.state, playback.reason) == (PlaybackState.WAITING, "")


@pytest.mark.parametrize("away", [0.0, 0.5])
def test_a_start_in_a_frame_that_has_jumped_since_is_not_gone_back_to(away):
    playback, there, now = returning()
    playback.abort("asked for")
    for t in np.arange(now + 0.1, now + 8.0, 0.1):  # the jump is older than the watch looks back
        begun_anew = replace(there, x=there.x + away * (t > now + 4.0))
        playback.observe(begun_anew, t, t)
        playback.hear(ARMED, t)
        playback.tick(t)
    if away:
        with pytest.raises(PlanError, match=r"jumped since \(the pose is 0.50 m .* by hand"):
            playback.go_back(t)
    else:
        playback.go_back(t)
    assert playback.state is (PlaybackState.ABORTED if away else PlaybackState.RETURNING)


def test_a_vehicle_that_has_no_start_cannot_go_back_to_it():
    with pytest.raises(PlanError, match="no start to go back to"):
        ready().go_back(10.0)


@pytest.mark.parametrize(
    ("state", "readiness", "reason"),
    [(MOVING, ARMED, "it must stand still"), (AT_REST, PRESSED, "hardware e-stop pressed")],
)
def test_a_way_back_begins_at_rest_and_armed(state, readiness, reason):
    playback, _, now = returning()
    playback.abort("asked for")
    for t in np.arange(now, now + 6.0, 0.1):
        playback.observe(AT_REST, t, t)
        playback.tick(t)
    playback.observe(state, t, t)
    playback.hear(readiness, t)
    with pytest.raises(PlanError, match=reason):
        playback.go_back(t)
