"""Returns to a planned start in a yard: the driver's own state machine on the 9-DOF vehicle.

    python benchmarks/way_back.py [--returns 100] [--vehicle FILE]

Start and goal are random poses with room for a stop. The vehicle is of a random draw from its
ranges, its boards are emulated, the localisation is that of the simulation with its noise, at 20 Hz
and one period late; the fence is on.
"""

import argparse
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from excitation_planner.area.area import Area
from excitation_planner.area.tube import footprint_of
from excitation_planner.localisation import PlanarState
from excitation_planner.playback import Playback
from excitation_planner.schedule import Schedule
from excitation_planner.vehicle_watch import VehicleWatch
from excitation_planner.way_back.dubins import Arc
from excitation_planner.way_back.pursuit import Chassis
from excitation_planner.way_back.route import FreeGround, RouteRequest, find_route
from tricycle_bridge.commands.command_stream import VehicleCommand
from tricycle_bringup.configuration import bridge_settings, turning_geometry
from tricycle_core.errors import PlanError
from tricycle_core.maneuver_state import PlaybackState
from tricycle_core.poses import Pose
from tricycle_core.readiness import Readiness
from tricycle_core.timing import TICK
from tricycle_sim.rig.emulated import EmulatedRig
from tricycle_sim.rig.host import Host
from tricycle_sim.rig.localisation import PoseNoise, measure_pose
from tricycle_sim.vehicle import Vehicle, draw_truth, load_vehicle

YARD = Area(np.array([[0.0, 0.0], [25.0, 0.0], [25.0, 12.0], [0.0, 12.0]]))
LONGEST = 300.0  # s of one return
POSE_TICKS = 5


@dataclass(frozen=True)
class Return:
    """How one return ended.

    Attributes
    ----------
    off : float
        Distance from the goal, true [m].
    turned : float
        From its heading, true [rad].
    duration : float
        Simulated [s].
    reason : str
        Why it was aborted.
    """

    off: float
    turned: float
    duration: float
    reason: str

    @property
    def arrived(self) -> bool:
        """Whether a maneuver may start there."""
        return not self.reason and self.off <= 0.05 and self.turned <= math.radians(1.0)


def random_pose(rng: np.random.Generator, area: Area, footprint: np.ndarray) -> Pose:
    """Draw a pose where the vehicle has room to stop forwards and backwards."""
    ground = tuple(area.within(area.margin))
    low, high = area.keep_in.min(axis=0), area.keep_in.max(axis=0)
    while True:
        x, y = rng.uniform(low, high).tolist()
        pose = x, y, float(rng.uniform(-math.pi, math.pi))
        room = FreeGround(RouteRequest(pose, pose, 1.0, ground, footprint))
        if room.free((Arc(pose, 0.0, 0.1), Arc(pose, 0.0, -0.1))):
            return pose


def chassis_of(vehicle: Vehicle) -> Chassis:
    """What the driver's parameters say of a vehicle."""
    unsteered = [vehicle.of(wheel).x for wheel in vehicle.wheels if not wheel.steered]
    return Chassis(turning_geometry(vehicle), float(np.mean(unsteered)), vehicle.driven_radius)


def go_back(vehicle: Vehicle, start: Pose, goal: Pose, seed: int, area: Area = YARD) -> Return:
    """Let a vehicle that stands at a start go back to a goal."""
    rng = np.random.default_rng(seed)
    rig = EmulatedRig(vehicle)
    rig.reset(start)
    host = Host(rig, bridge_settings(vehicle))
    host.arm()
    playback = Playback(
        VehicleWatch(odom_timeout=0.5), max_deviation=1.0, chassis=chassis_of(vehicle)
    )
    playback.load(Schedule(np.array([0.0, 1.0]), np.zeros(2), np.zeros(2)))
    playback.parts.add_area(
        {
            "ground": (area.frame, area.within(area.margin)),
            "footprint": footprint_of(vehicle),
            "planned_start": goal,
            "twist": np.zeros(2),
        }
    )
    began, pending = rig.time, None
    while rig.time - began < LONGEST:
        now = rig.time
        playback.hear(Readiness(rig.armed, "" if rig.armed else "; ".join(host.log[-3:]), ""), now)
        if round(now / TICK) % POSE_TICKS == 0:
            if pending is not None:
                playback.observe(*pending, now)
            pose = measure_pose(rig.state, PoseNoise(), rng)
            speed, slip = math.hypot(pose.vx, pose.vy), math.atan2(pose.vy, pose.vx)
            state = PlanarState(pose.x, pose.y, pose.yaw, speed, slip, pose.yaw_rate, area.frame)
            if pending is None:
                playback.observe(state, now, now)
                playback.tick(now)
                playback.go_back(now)
            pending = state, now
        if (request := playback.route_wanted) is not None:
            try:
                playback.follow(find_route(request))
            except PlanError as error:
                playback.abort(str(error))
        command = playback.tick(now)
        if pending is not None and not playback.state.driving:
            break
        if command is not None:
            speed = command.wheel_rate * playback.chassis.tyre_radius
            host.target = VehicleCommand(command.steering_motor_angle, speed)
        host.tick()
    state = rig.state
    reason = playback.reason
    if playback.state is PlaybackState.RETURNING:
        reason = f"not there after {LONGEST:.0f} s"
    return Return(
        math.hypot(state.x - goal[0], state.y - goal[1]),
        abs(math.remainder(state.yaw - goal[2], math.tau)),
        rig.time - began,
        reason,
    )


def main() -> None:
    """Run the returns and print how they ended."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--returns", type=int, default=100)
    parser.add_argument("--first", type=int, default=0, help="seed of the first return")
    parser.add_argument("--vehicle", type=Path, help="vehicle YAML")
    args = parser.parse_args()
    vehicle, ends = load_vehicle(args.vehicle), []
    for seed in range(args.first, args.first + args.returns):
        rng = np.random.default_rng(seed)
        true = vehicle.replace(**draw_truth(vehicle, rng))
        start, goal = (random_pose(rng, YARD, footprint_of(vehicle)) for _ in range(2))
        ends.append(go_back(true, start, goal, seed))
        if not ends[-1].arrived:
            print(f"seed {seed}: {ends[-1]}")
    there = [end for end in ends if end.arrived]
    print(f"{len(there)} of {len(ends)} returns end within 5 cm and 1 deg of the start")
    if there:
        print(
            f"farthest {1e3 * max(e.off for e in there):.0f} mm, "
            f"{math.degrees(max(e.turned for e in there)):.2f} deg; "
            f"median {np.median([e.duration for e in there]):.0f} s, "
            f"longest {max(e.duration for e in there):.0f} s"
        )


if __name__ == "__main__":
    main()
