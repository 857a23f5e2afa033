"""Plans in yards: room that random vehicles leave, what a yard costs, and faults on the way.

    python benchmarks/yards.py [--vehicles 1000] [--drives 5] [--part plans|seeds|limits|faults]
                               [--families ...] [--yards usual|other|NAME]
                               [--seeds 1] [--evaluations 600] [--below 0.8]

plans   each family is planned without a yard and in some of them, by criterion c for the cornering
        stiffness. Printed: what share of the information is kept (variance free over variance in
        the yard), how many times as much processor time the planning took, and how many of the
        random vehicles of the ranges, begun up to 5 cm and 1 deg beside the planned start, come
        closer to the border than the margin, and how close the closest comes.
seeds   the same plans with several seeds. Printed: information over that without a yard and that of
        the best of them, each the least and the mean of the seeds, and the mean processor time.
limits  those of these plans that keep less of the information than 80 %, beside the best maneuver
        that any operation parameters give in the yard, by a random search with many evaluations.
        Printed: information of both over that without a yard, and the share of the best that the
        plan has: what the search loses, not the yard. With several seeds, the least of the plans
        and the best of the random searches.
faults  vehicles of random draws drive these plans behind emulated boards, by the driver's own state
        machine and its fence, on the 9-DOF vehicle. At a random time the localisation jumps by 2 m,
        freezes, drifts by the margin within 5 s, or the host falls silent and the boards' watchdogs
        stop the vehicle. Printed: how the drives ended, and how far the true footprint stayed from
        the border; negative: it was out.
"""

import argparse
import collections
import math
import re
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import shapely

from excitation_planner import Criterion
from excitation_planner.area.area import Area, StartRegion
from excitation_planner.area.fence import START_HEADING_TOLERANCE, START_POSITION_TOLERANCE
from excitation_planner.area.room import Room
from excitation_planner.area.tube import footprint_of
from excitation_planner.box import Box
from excitation_planner.design.information import (
    difference_points,
    information,
    posterior_covariance,
)
from excitation_planner.design.problem import DRAWS
from excitation_planner.indices.sampling import sobol_sequence
from excitation_planner.localisation import PlanarState
from excitation_planner.maneuver import family_by_name, family_names, with_ranges
from excitation_planner.planning import PlanRequest, plan_maneuver
from excitation_planner.planning.prediction import replayed
from excitation_planner.planning.replay import nominal_commands
from excitation_planner.playback import Playback
from excitation_planner.schedule import Schedule
from excitation_planner.vehicle_watch import VehicleWatch
from tricycle_bridge.commands.command_stream import VehicleCommand
from tricycle_bringup.configuration import bridge_settings
from tricycle_core.errors import DesignError, InfeasibleManeuver, PlanError
from tricycle_core.poses import placed
from tricycle_core.readiness import Readiness
from tricycle_core.timing import TICK
from tricycle_sim.rig.emulated import EmulatedRig
from tricycle_sim.rig.host import Host
from tricycle_sim.rig.localisation import PoseNoise, measure_pose
from tricycle_sim.vehicle import draw_truth, load_vehicle
from tricycle_sim.vehicle.batch import simulate

VEHICLE = load_vehicle()
FOOTPRINT = footprint_of(VEHICLE)
TARGET = "cornering_stiffness"
POST = np.array([[0.0, 0.0], [0.3, 0.0], [0.3, 0.3], [0.0, 0.3]])
YARDS = {
    "12 x 25 m": Area(np.array([[0.0, 0.0], [25.0, 0.0], [25.0, 12.0], [0.0, 12.0]])),
    "30 x 30 m, two posts": Area(
        np.array([[0.0, 0.0], [30.0, 0.0], [30.0, 30.0], [0.0, 30.0]]),
        (POST + np.array([10.0, 12.0]), POST + np.array([20.0, 20.0])),
    ),
    "L of 60 m, 9 m wide": Area(
        np.array([[0.0, 0.0], [60.0, 0.0], [60.0, 9.0], [9.0, 9.0], [9.0, 60.0], [0.0, 60.0]]),
        start=StartRegion(heading=(-0.2, 0.2)),
    ),
}
# these decided between variants of the search only
OTHER_YARDS = {
    "15 x 18 m, a pillar": Area(
        np.array([[0.0, 0.0], [18.0, 0.0], [18.0, 15.0], [0.0, 15.0]]),
        (POST + np.array([6.0, 7.0]),),
    ),
    "10 x 40 m": Area(np.array([[0.0, 0.0], [40.0, 0.0], [40.0, 10.0], [0.0, 10.0]])),
    "trapezoid of 30 m": Area(np.array([[0.0, 0.0], [30.0, 0.0], [21.0, 16.0], [6.0, 16.0]])),
}
EVERY = 10  # ticks between the footprints that are looked at
FAULTS = ("none", "jumps", "freezes", "drifts", "host falls silent")
POSE_TICKS = 5


def bounds_of(area):
    """What a footprint must not touch."""
    return shapely.union_all(
        [shapely.Polygon(area.keep_in).exterior, *map(shapely.Polygon, area.keep_out)]
    )


def clearance(area, x, y, yaw):
    """Distance (n, t) of footprints from what bounds an area; negative where one is not inside."""
    outlines = shapely.polygons(placed(FOOTPRINT, x, y, yaw))
    distance = shapely.distance(outlines, bounds_of(area))
    inside = shapely.contains_xy(shapely.Polygon(area.keep_in), x, y)
    return np.where(inside & (distance > 0.0), distance, -1.0)


def beside(start, rng, count, share=1.0):
    """Random starts (count, 3), within a share of the tolerances of the driver."""
    x, y, heading = start
    off = share * START_POSITION_TOLERANCE * np.sqrt(rng.uniform(size=count))
    direction = rng.uniform(-math.pi, math.pi, count)
    turned = heading + share * START_HEADING_TOLERANCE * rng.uniform(-1.0, 1.0, count)
    return np.column_stack([x + off * np.cos(direction), y + off * np.sin(direction), turned])


def closest(area, plan, count):
    """Least clearance (count,) of random vehicles in the undisturbed drive of a plan."""
    rng = np.random.default_rng(1)
    low, high = np.array(list(VEHICLE.unknown.values())).T
    motion = simulate(VEHICLE, plan.commands, rng.uniform(low, high, (count, len(low))))
    x, y, yaw = (column[:, ::EVERY] for column in (motion.x, motion.y, motion.yaw))
    starts = beside(plan.start_pose, rng, count)[:, :, None]
    cosine, sine = np.cos(starts[:, 2]), np.sin(starts[:, 2])
    placed_x = starts[:, 0] + cosine * x - sine * y
    placed_y = starts[:, 1] + sine * x + cosine * y
    return clearance(area, placed_x, placed_y, starts[:, 2] + yaw).min(axis=1)


def planned(family, area, budget, seed=0):
    """The plan, or why there is none; and the processor time that it took [s]."""
    request = PlanRequest(VEHICLE, family, TARGET, Criterion.C, area=area, budget=budget, seed=seed)
    begun = time.process_time()
    with ThreadPoolExecutor(1) as executor:  # in this process, whose time is counted
        try:
            found = plan_maneuver(request, executor=executor)
        except (DesignError, PlanError) as error:
            found = str(error)
    return found, time.process_time() - begun


def cells(families, yards, budget):
    """Label, family and area of each table row; plan without a yard, and the time it took [s]."""
    # no plan that is timed compiles
    planned(family_by_name("circle"), YARDS["30 x 30 m, two posts"], budget)
    for name in families:
        family = family_by_name(name)
        free, free_time = planned(family, None, budget)
        (smaller,) = with_ranges([family], {}, smaller=True)  # as `tricycle plan --area` does
        for yard, area in yards.items():
            yield f"{name:20s}{yard:22s}", smaller, area, free, free_time


def try_plans(families, yards, count, budget):
    """Print the table of plans; returns those that fit, with their area."""
    found = []
    print(f"{'family':20s}{'yard':22s} information   time   in margin   closest")
    for label, family, area, free, free_time in cells(families, yards, budget):
        plan, seconds = planned(family, area, budget)
        if isinstance(plan, str):
            print(f"{label} {plan[:90]}", flush=True)
            continue
        kept = free.criterion_cost / plan.criterion_cost
        least = closest(area, plan, count)
        print(
            f"{label}{kept:11.0%} {seconds / free_time:6.1f}"
            f"{np.sum(least < area.margin):6d} of {count}{least.min():8.2f} m",
            flush=True,
        )
        found.append((area, plan))
    return found


def kept_with_seeds(family, area, budget, seeds, free):
    """Information (n,) of plans with several seeds over that without a yard; mean time [s]."""
    found = (planned(family, area, budget, seed) for seed in range(seeds))
    plans, times = zip(*found, strict=True)
    kept = [0.0 if isinstance(p, str) else free.criterion_cost / p.criterion_cost for p in plans]
    return np.array(kept), float(np.mean(times))


def try_seeds(families, yards, budget, seeds):
    print(f"{'':42s}information     of the best")
    print(f"{'family':20s}{'yard':22s}least   mean    least   mean    time")
    for label, family, area, free, free_time in cells(families, yards, budget):
        kept, seconds = kept_with_seeds(family, area, budget, seeds, free)
        best = kept / kept.max() if kept.any() else kept
        print(
            f"{label}{kept.min():5.0%}{kept.mean():7.0%}{best.min():9.0%}"
            f"{best.mean():7.0%}{seconds / free_time:8.1f}",
            flush=True,
        )


def best_that_fits(family, area, evaluations, seed):
    """Least cost of maneuvers that fit, by Sobol' points and random steps from the best of them."""
    noise, unknown = (
        PlanRequest(VEHICLE, family, TARGET, Criterion.C).noise,
        Box.of(VEHICLE.unknown),
    )
    room, rng = Room(area, FOOTPRINT, noise.position_std), np.random.default_rng(seed)
    U = difference_points(len(unknown), DRAWS, seed=1)
    fitting = []

    def judge(u):
        try:
            commands = nominal_commands(VEHICLE, family, family.operation.from_unit(u))
            Y = replayed(VEHICLE, commands, noise.channels, unknown.from_unit(U))
            covariance = posterior_covariance(information(U, Y, noise.of_trajectory))
            cost = covariance[:, unknown.index(TARGET), unknown.index(TARGET)].mean()
            if len(fitting) < 5 or cost < sorted(c for c, _ in fitting)[4]:
                room.check(VEHICLE, commands)
                fitting.append((cost, u))
        except InfeasibleManeuver:
            pass

    for u in sobol_sequence(evaluations // 2, len(family.operation), seed=seed):
        judge(u)
    for _ in range(evaluations // 2 if fitting else 0):
        best = sorted(fitting, key=lambda pair: pair[0])[:5]
        step = rng.choice([0.02, 0.06, 0.15]) * rng.standard_normal(len(family.operation))
        judge(np.clip(best[rng.integers(len(best))][1] + step, 0.0, 1.0))
    return min((cost for cost, _ in fitting), default=math.inf)


def try_limits(families, yards, budget, seeds, evaluations, below):
    print(f"{'family':20s}{'yard':22s}    plan    best   plan / best")
    for label, family, area, free, _ in cells(families, yards, budget):
        kept, _ = kept_with_seeds(family, area, budget, seeds, free)
        if kept.min() >= below:
            continue
        least = min(best_that_fits(family, area, evaluations, seed) for seed in range(seeds))
        # what a plan has found can be found
        best = max(free.criterion_cost / least, kept.max())
        share = kept.min() / best if best else 1.0
        print(f"{label}{kept.min():8.0%}{best:8.0%}{share:14.0%}", flush=True)


def disturbed(fault, state, since, frozen):
    """What a localisation says since a fault began, some seconds ago."""
    if since < 0.0:
        return state
    if fault == "jumps":
        return (state[0] + 2.0, *state[1:])
    if fault == "freezes":
        return frozen
    if fault == "drifts":
        return (state[0], state[1] + 0.1 * min(since, 5.0), *state[2:])
    return state


def driven(area, plan, fault, seed):
    """Least clearance of a drive [m], and how it ended."""
    rng = np.random.default_rng([seed, FAULTS.index(fault)])
    true = VEHICLE.replace(**draw_truth(VEHICLE, rng))
    rig = EmulatedRig(true)
    # what is measured of the start has to be within the tolerances too
    rig.reset(tuple(beside(plan.start_pose, rng, 1, 0.2)[0].tolist()))
    host = Host(rig, bridge_settings(VEHICLE))
    host.arm()
    playback = Playback(VehicleWatch(odom_timeout=0.5), max_deviation=1.0)
    commands = plan.commands
    rates = commands.speed / plan.tyre_radius
    playback.load(Schedule(commands.time, commands.steering_motor_angle, rates))
    playback.parts.add_path(plan.path)
    fence = plan.fence
    playback.parts.add_area(
        {
            "ground": (fence.frame, fence.ground),
            "footprint": fence.footprint,
            "planned_start": fence.start,
            "twist": fence.curvature,
        }
    )
    fault_at = math.inf if fault == "none" else rng.uniform(0.05, 0.95) * commands.duration
    began, started, pending, frozen, track, ended = rig.time, None, None, None, [], None
    while ended is None or rig.time < ended + 5.0:
        now = rig.time
        playback.hear(Readiness(rig.armed, "" if rig.armed else "; ".join(host.log[-3:]), ""), now)
        if round(now / TICK) % POSE_TICKS == 0:
            if pending is not None:
                playback.observe(*pending, now)
            p = measure_pose(rig.state, PoseNoise(), rng)
            speed, slip = math.hypot(p.vx, p.vy), math.atan2(p.vy, p.vx)
            seen = (p.x, p.y, p.yaw, speed, slip, p.yaw_rate)
            since = -1.0 if started is None else now - started - fault_at
            if since < 0.0:
                frozen = seen
            pending = PlanarState(*disturbed(fault, seen, since, frozen), area.frame), now
        if started is None and now > began + 1.0:
            playback.tick(now)
            playback.start(now)
            started = now
        command = playback.tick(now)
        if command is not None:
            wheel = command.wheel_rate * plan.tyre_radius
            host.target = VehicleCommand(command.steering_motor_angle, wheel)
        if fault == "host falls silent" and started is not None and now - started > fault_at:
            host.kill()
        host.tick()
        track.append((rig.state.x, rig.state.y, rig.state.yaw))
        if ended is None and started is not None and not playback.state.driving:
            ended = now
    least = clearance(area, *np.array(track[::EVERY]).T).min()
    assert math.hypot(rig.state.vx, rig.state.vy) < 0.05, "it still drives"
    return least, playback.reason or playback.state.value


def try_faults(plans, drives):
    print(f"\n{'fault':20s}{'drives':>7s}{'out':>5s}{'closest':>10s}  ended")
    for fault in FAULTS:
        ends = [driven(area, plan, fault, seed) for area, plan in plans for seed in range(drives)]
        least = np.array([least for least, _ in ends])
        reasons = collections.Counter(
            re.sub(r"[\d.]+", "…", reason.split(":")[0]) for _, reason in ends
        )
        print(
            f"{fault:20s}{len(ends):7d}{np.sum(least < 0.0):5d}{least.min():8.2f} m  "
            + ", ".join(f"{count} {reason}" for reason, count in reasons.most_common(4)),
            flush=True,
        )


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--families", default=",".join(family_names()))
    parser.add_argument(
        "--budget", type=int, default=PlanRequest.budget, help="simulations of a plan"
    )
    parser.add_argument("--vehicles", type=int, default=1000)
    parser.add_argument("--drives", type=int, default=5, help="of each plan and fault")
    parser.add_argument("--seeds", type=int, default=1, help="of seeds and limits")
    one = {name: {name: area} for name, area in (YARDS | OTHER_YARDS).items()}
    sets = {"usual": YARDS, "other": OTHER_YARDS, **one}
    parser.add_argument("--yards", choices=sets, default="usual")
    parser.add_argument("--part", choices=("plans", "seeds", "limits", "faults"), default="faults")
    parser.add_argument("--evaluations", type=int, default=600, help="of the search of a limit")
    parser.add_argument("--below", type=float, default=0.8, help="information of plans of limits")
    arguments = parser.parse_args()
    families, budget, seeds = arguments.families.split(","), arguments.budget, arguments.seeds
    yards = sets[arguments.yards]
    if arguments.part == "limits":
        try_limits(families, yards, budget, seeds, arguments.evaluations, arguments.below)
        return
    if arguments.part == "seeds":
        try_seeds(families, yards, budget, seeds)
        return
    plans = try_plans(families, yards, arguments.vehicles, budget)
    if arguments.part == "faults":
        try_faults(plans, arguments.drives)


if __name__ == "__main__":
    main()
