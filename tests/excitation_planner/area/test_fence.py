"""The fence: what is stopped when it says so stays on the ground, and what fits is not stopped."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from excitation_planner.area.area import MAX_CORNERS, Area, StartRegion
from excitation_planner.area.fence import ARC_SPACING, MAX_ARCS, SPACING, Fence
from excitation_planner.area.polygons import contains, rings_of
from excitation_planner.area.room import Room
from excitation_planner.area.stops import longest_stop, stopping_path
from excitation_planner.area.tube import crawl_curvature, footprint_of, tube_of
from excitation_planner.localisation import PlanarState, PoseWatch
from excitation_planner.maneuver import family_by_name
from excitation_planner.planning.replay import nominal_run
from tricycle_core.errors import PlanError
from tricycle_core.poses import placed, seen_from
from tricycle_core.quantities import FloatArray
from tricycle_core.timing import TICK
from tricycle_sim.commands import Commands
from tricycle_sim.rig.localisation import PoseNoise
from tricycle_sim.setpoints import command_rows
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.batch import Trajectory, simulate

FOOTPRINT = np.array([[1.0, 0.5], [-1.0, 0.5], [-1.0, -0.5], [1.0, -0.5]])
YARD = np.array([[0.0, 0.0], [12.0, 0.0], [12.0, 25.0], [0.0, 25.0]])
LATENCY = 2  # ticks by which a pose is old when the fence looks at it


def fence(
    *keep_out: list[list[float]], start: tuple[float, float, float] = (6.0, 5.0, 0.0)
) -> Fence:
    area = Area(YARD, tuple(map(np.array, keep_out)), margin=0.5)
    return Fence("odom", area.within(0.5), FOOTPRINT, np.zeros(2), start)


def at(x: float, y: float, yaw: float = 0.0, speed: float = 0.0, rate: float = 0.0) -> PlanarState:
    return PlanarState(x, y, yaw, speed, yaw_rate=rate, frame="odom")


def said(state: PlanarState, the_fence: Fence | None = None, **other: float) -> str:
    options = {"age": 0.0, "curvature": 0.0, "push": 0.0} | other
    return (the_fence or fence()).trespass(state, **options)


@pytest.mark.parametrize("curvature", [1e308, -101.0])
def test_a_curvature_that_no_vehicle_has_is_refused(curvature: float) -> None:
    with pytest.raises(PlanError, match="sharper than any vehicle turns"):
        replace(fence(), curvature=np.array([0.0, curvature]))


def test_who_stands_inside_may_and_who_stands_in_the_margin_may_not() -> None:
    assert said(at(10.4, 10.0)) == ""
    assert said(at(10.7, 10.0)).startswith("fence: 0.20 m out of the area less its margin")


def test_a_stop_that_would_leave_is_told_with_the_way_to_it() -> None:
    assert said(at(8.0, 10.0, speed=1.0)) == ""
    assert "would come" in said(at(9.6, 10.0, speed=1.0))
    assert said(at(9.6, 10.0, math.pi, speed=1.0)) == ""
    # backwards: the motion counts, not the heading
    backwards = PlanarState(9.6, 10.0, math.pi, 1.0, slip=math.pi, frame="odom")
    assert "would come" in said(backwards)


def test_who_creeps_goes_where_the_commands_push() -> None:
    assert said(at(10.4, 10.0), push=1.0)
    assert said(at(10.4, 10.0), push=-1.0) == ""


def test_the_way_made_since_the_pose_counts() -> None:
    state = at(8.9, 10.0, speed=1.0)
    assert said(state) == ""
    assert "would come" in said(state, age=0.4)


def test_the_arc_of_the_commands_counts_as_that_of_the_motion_does() -> None:
    along_the_border = at(3.0, 1.3, speed=2.0)
    assert said(along_the_border) == ""
    assert "would come" in said(along_the_border, curvature=-0.1)
    assert "would come" in said(at(3.0, 1.3, speed=2.0, rate=-0.2))


def test_backwards_the_arc_of_the_commands_bends_the_other_way() -> None:
    """Heading -x, moving +x: with the wheels to the left, which is -y, it bends to the border."""
    backwards = PlanarState(3.0, 1.3, math.pi, 2.0, slip=math.pi, frame="odom")
    assert said(backwards) == ""
    assert said(backwards, curvature=-0.1) == ""
    assert "would come" in said(backwards, curvature=0.1)


def test_an_obstacle_smaller_than_the_footprint_is_seen() -> None:
    post = [[6.0, 9.95], [6.1, 9.95], [6.1, 10.05], [6.0, 10.05]]
    around = Fence(
        "odom", Area(YARD, (np.array(post),)).within(0.01), FOOTPRINT, np.zeros(2), (0,) * 3
    )
    assert said(at(4.0, 10.0), around) == ""
    assert "would come" in said(at(4.0, 10.0, speed=1.0), around)


def test_a_wall_that_only_sides_cross_is_seen() -> None:
    wall = np.array([[4.0, 9.99], [8.0, 9.99], [8.0, 10.01], [4.0, 10.01]])
    around = Fence("odom", Area(YARD, (wall,)).within(0.0), FOOTPRINT, np.zeros(2), (0,) * 3)
    assert said(at(6.0, 10.0, math.pi / 2), around)
    assert said(at(6.0, 11.1, math.pi / 2), around) == ""


def test_a_vehicle_is_as_far_out_as_its_corners_are_or_those_in_it() -> None:
    def depth(x: float, *posts: FloatArray) -> str:
        around = Fence("odom", Area(YARD, posts).within(0.0), FOOTPRINT, np.zeros(2), (0,) * 3)
        return said(at(x, 10.0), around).split(" m ")[0]

    assert depth(11.5) == "fence: 0.50"
    assert depth(20.0) == "fence: 9.00"
    post = np.array([[6.7, 9.9], [6.9, 9.9], [6.9, 10.1], [6.7, 10.1]])
    assert depth(6.0, post) == "fence: 0.30"


def test_a_footprint_that_crosses_itself_is_refused() -> None:
    with pytest.raises(PlanError, match="footprint: crosses itself"):
        Fence("odom", (YARD,), FOOTPRINT[[0, 2, 1, 3]], np.zeros(2), (0,) * 3)


def _star(rng: np.random.Generator, x: float, y: float, reach: float, corners: int) -> FloatArray:
    turn = math.tau * (np.arange(corners) + rng.uniform(0.1, 0.9, corners)) / corners
    radii = reach * rng.uniform(0.4, 1.0, (corners, 1))
    return radii * np.stack([np.cos(turn), np.sin(turn)], axis=-1) + [x, y]


@settings(max_examples=300)
@given(
    seed=st.integers(0, 2**32 - 1),
    speed=st.sampled_from([0.0, 0.5, 1.0, 2.0, 4.0]),
    rate=st.floats(-1.0, 1.0),
    curvature=st.floats(-0.4, 0.4),
)
def test_verdicts_are_those_of_shapely_and_no_weaker_than_before(
    seed: int, speed: float, rate: float, curvature: float
) -> None:
    """In random yards whose obstacles may overlap, and divide the ground."""
    rng = np.random.default_rng(seed)
    posts = tuple(
        _star(rng, *rng.uniform(-12.0, 12.0, 2), rng.uniform(0.1, 3.0), int(rng.integers(3, 12)))
        for _ in range(rng.integers(0, 7))
    )
    yard = Area(_star(rng, 0.0, 0.0, 30.0, int(rng.integers(5, 60))), posts)
    ground = yard.within(rng.choice([0.0, 0.3]))
    x, y, yaw = rng.uniform([-15.0, -15.0, -3.0], [15.0, 15.0, 3.0]).tolist()
    guard = Fence("odom", ground, FOOTPRINT, np.zeros(2), (0.0, 0.0, 0.0))
    reason = said(at(x, y, yaw, speed, rate), guard, curvature=curvature)

    way = speed * TICK + float(longest_stop(np.array(speed))) if speed else 0.0
    now = rate / speed if speed else 0.0
    number = 2 + int(0.5 * abs(curvature - now) * way**2 / ARC_SPACING)
    arcs = np.linspace(now, curvature, min(number, MAX_ARCS))
    points = 1 + math.ceil(way / SPACING)
    poses = stopping_path(x, y, yaw, 0.0, way, arcs, points=points)
    before = ~contains(placed(FOOTPRINT, *poses), ground).all(axis=-1)
    before |= contains(seen_from(np.concatenate(ground), *poses), (FOOTPRINT,)).any(axis=-1)
    assert reason or not before.any()

    parts = shapely.build_area(shapely.multilinestrings([shapely.linearrings(r) for r in ground]))
    shapely.prepare(parts)
    out = ~shapely.covers(parts, shapely.polygons(placed(FOOTPRINT, *poses))).all(axis=0)
    assert bool(reason) == out.any()
    if out.any() and not out[0]:
        assert reason.endswith(f" in {np.linspace(0.0, way, points)[np.argmax(out)]:.1f} m")


def test_of_the_largest_ground_each_obstacle_counts() -> None:
    number = (MAX_CORNERS - 4) // 3
    places = np.stack(np.divmod(np.arange(number), 26), axis=-1) * 3.0 + 3.0
    triangle = np.array([[0.0, 0.0], [0.2, 0.0], [0.0, 0.2]])
    yard = 90.0 * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    ground = Area(yard, tuple(triangle + place for place in places)).within(0.1)
    guard = Fence("odom", ground, FOOTPRINT, np.zeros(2), (0.0, 0.0, 0.0))
    for x, y in places.tolist():
        assert said(at(x, y), guard)
        assert said(at(x + 1.5, y + 1.5), guard) == ""


def test_poses_of_another_frame_or_without_a_turn_rate_are_refused() -> None:
    assert "frame 'odom'" in said(PlanarState(6.0, 10.0, 0.0, 0.0, frame="map"))
    assert "turn rate" in said(at(6.0, 10.0, rate=math.nan))


@pytest.mark.parametrize("speed", [10.0, 1e3, 1e6, 1e200, math.inf, math.nan])
def test_a_speed_that_no_vehicle_has_is_refused_before_its_stop_is_laid_out(speed: float) -> None:
    assert said(at(6.0, 10.0, speed=speed, rate=1.0))


@pytest.mark.parametrize("age", [60.0, 1e6, 1e300])
def test_a_stop_from_a_pose_of_long_ago_is_refused_before_it_is_laid_out(age: float) -> None:
    assert "a stop would take" in said(at(6.0, 10.0, speed=4.0, rate=1.0), age=age)


def test_a_turn_rate_that_no_vehicle_has_is_refused() -> None:
    assert "turn rate of 1e+308" in said(at(6.0, 10.0, speed=1.0, rate=1e308))


def test_off_the_start_is_told_as_directions() -> None:
    there = fence(start=(6.0, 5.0, math.pi / 2))
    assert there.off_start(at(6.03, 5.0, math.pi / 2)) == ""
    told = there.off_start(at(5.98, 4.6, math.pi / 2 + math.radians(3.0)))
    assert told.startswith(
        "0.40 m back and 0.02 m left of the planned start, heading 3.0 deg to the left"
    )


@pytest.mark.parametrize("turn", [0.0, math.pi / 2])
def test_each_deviation_from_the_start_is_enough_to_be_off(turn: float) -> None:
    there = fence(start=(6.0, 5.0, turn))
    for aside in (0.06, -0.06):
        assert there.off_start(at(6.0 + aside, 5.0, turn))
        assert there.off_start(at(6.0, 5.0 + aside, turn))
        assert there.off_start(at(6.0, 5.0, turn + math.copysign(math.radians(1.1), aside)))


def test_a_margin_that_leaves_nothing_is_refused() -> None:
    with pytest.raises(PlanError, match="nothing of the area"):
        Area(YARD).within(7.0)


def test_the_watch_finds_jumps_and_what_is_frozen_but_no_motion() -> None:
    def watched(poses: list[tuple[float, PlanarState]]) -> str:
        watch = PoseWatch()
        return next(filter(None, (watch.contradiction(s, t, driven=True) for t, s in poses)), "")

    times = (0.01 * np.arange(300)).tolist()
    turning = [
        (t, at(2.0 * math.sin(0.5 * t), 2.0 * (1.0 - math.cos(0.5 * t)), 0.5 * t, 1.0, 0.5))
        for t in times
    ]
    assert watched(turning) == ""
    jumped = [(t, s if t < 1.5 else at(s.x + 2.0, s.y, s.yaw, 1.0, 0.5)) for t, s in turning]
    assert "2.0" in watched(jumped)
    turned = [(t, s if t < 1.5 else at(s.x, s.y, s.yaw + 0.5, 1.0, 0.5)) for t, s in turning]
    assert "heading" in watched(turned)
    gap = [(t, s if t != 0.5 else replace(s, yaw_rate=math.nan)) for t, s in turned]
    assert "heading" in watched(gap)  # a lost turn rate blinds it for no longer than it lasts
    assert "velocity led" in watched([(t, at(0.0, 0.0, 0.0, 1.0)) for t in times])
    assert "the same for" in watched([(t, at(0.0, 0.0)) for t in times])
    ahead = [(0.0, at(0.0, 0.0)), (50.0, at(0.001, 0.0)), *((t, at(0.0, 0.0)) for t in times[1:])]
    assert "the same for 0.5" in watched(ahead)  # a stamp ahead blinds it for no longer either
    drifting = [(t, at(s.x + 0.5 * t, s.y, s.yaw, 1.0, 0.5)) for t, s in turning]
    assert "velocity led" in watched(drifting)


@pytest.mark.slow
def test_random_vehicles_that_are_stopped_by_it_stay_in_their_yard() -> None:
    """100 in 5 yards, from 0.5 to 3 m/s, steered anyhow: none leaves its yard.

    While the wheels turn, the way to rest is no arc, and a vehicle may need some of the margin.
    """
    vehicle = load_vehicle()
    footprint = footprint_of(vehicle)
    rng = np.random.default_rng(3)
    low, high = np.array(list(vehicle.unknown.values())).T
    stopped = 0
    for _ in range(5):
        time = np.arange(0.0, 20.0, 2.0)
        speed = np.repeat(rng.uniform(0.5, 3.0, 2), 5)
        angle = np.clip(rng.normal(0.0, 0.3 / speed), -0.5, 0.5)
        commands = Commands(time, angle, speed)
        curvature = crawl_curvature(vehicle, angle)
        yard = _random_yard(rng)
        the_fence, border = (
            Fence("odom", yard.within(distance), footprint, curvature, (0.0, 0.0, 0.0))
            for distance in (yard.margin, 0.0)
        )
        parameters = rng.uniform(low, high, (20, len(low)))
        motion = simulate(vehicle, commands, parameters)
        for n in np.flatnonzero(~motion.feasibility.rolled_over.happened):
            tick = _first_stop(the_fence, motion, n, commands)
            if not tick:
                continue
            stop = _stopped(commands, tick * TICK)
            end = simulate(vehicle, stop, parameters[[n]])
            assert math.hypot(end.vx[0, -1], end.vy[0, -1]) < 0.02
            poses = zip(*(c[0, tick::10] for c in (end.x, end.y, end.yaw)), strict=True)
            out = [reason for pose in poses if (reason := said(at(*pose), border))]
            assert not out, f"stopped at {motion.time[tick]:.2f} s: {out[-1]}"
            stopped += 1
    assert stopped > 50


@pytest.mark.slow
@pytest.mark.parametrize(("name", "x"), [("circle", [3.0, 0.8]), ("double-lane-change", None)])
def test_a_drive_whose_tube_just_fits_is_not_stopped(name: str, x: list[float] | None) -> None:
    vehicle, family = load_vehicle(), family_by_name(name)
    point = np.array(family.operation.high) if x is None else np.array(x)
    commands = nominal_run(vehicle, family, point).commands
    footprint, noise = footprint_of(vehicle), PoseNoise()
    tube = tube_of(vehicle, commands, footprint).whole
    everywhere = Area(1e3 * (YARD - YARD.mean(axis=0)), start=StartRegion((0, 0), (0, 0), (0, 0)))
    needed = Room(everywhere, footprint, noise.position).fit(vehicle, commands).needed
    area = Area(rings_of(tube.buffer(needed))[0])
    curvature = crawl_curvature(vehicle, commands.steering_motor_angle)
    the_fence = Fence("odom", area.within(area.margin), footprint, curvature, (0.0, 0.0, 0.0))
    rng = np.random.default_rng(4)
    low, high = np.array(list(vehicle.unknown.values())).T
    motion = simulate(vehicle, commands, rng.uniform(low, high, (10, len(low))))
    for n in range(10):
        assert _first_stop(the_fence, motion, n, commands, noise=noise) is None


def _random_yard(rng: np.random.Generator) -> Area:
    """Around the origin, and a small obstacle."""
    angles = np.sort(rng.uniform(-np.pi, np.pi, 12))
    radii = rng.uniform(8.0, 16.0, 12)
    corners = radii[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    post = rng.uniform(3.0, 5.0, 2) + np.array([[0.0, 0.0], [0.2, 0.0], [0.0, 0.2]])
    return Area(corners, (post,))


def _first_stop(
    the_fence: Fence,
    motion: Trajectory,
    n: int,
    commands: Commands,
    *,
    noise: PoseNoise | None = None,
) -> int | None:
    """Tick at which the fence stops vehicle n; it is asked at every fifth."""
    rng = np.random.default_rng(n)
    rows = command_rows(commands)
    for tick in range(0, len(rows), 5):
        x, y, yaw, u, v, rate = (
            float(getattr(motion, name)[n, max(tick - LATENCY, 0)])
            for name in ("x", "y", "yaw", "vx", "vy", "yaw_rate")
        )
        if noise is not None:
            e = rng.standard_normal(6)
            x, y, yaw = x + noise.position * e[0], y + noise.position * e[1], yaw + noise.yaw * e[2]
            u, v, rate = (
                u + noise.speed * e[3],
                v + noise.speed * e[4],
                rate + noise.yaw_rate * e[5],
            )
        state = PlanarState(x, y, yaw, math.hypot(u, v), math.atan2(v, u), rate, "odom")
        row = rows[tick]
        if said(
            state,
            the_fence,
            age=LATENCY * TICK,
            curvature=float(the_fence.curvature[row]),
            push=float(commands.speed[row]),
        ):
            return tick
    return None


def _stopped(commands: Commands, at_time: float) -> Commands:
    """The commands until a time, then standstill with the steering held, as the driver does."""
    before = commands.time < at_time - 1e-9
    held = commands.steering_motor_angle[before][-1]
    return Commands(
        np.append(commands.time[before], at_time + np.array([0.0, 8.0])),
        np.append(commands.steering_motor_angle[before], [held, held]),
        np.append(commands.speed[before], [0.0, 0.0]),
    )
