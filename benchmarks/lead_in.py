"""Lead-ins: where vehicles are when the maneuver proper begins, open loop and kept on their line.

    python benchmarks/lead_in.py [--vehicles 50]

Random vehicles of the tricycle's ranges, with a zero of the steering and a gain of it that the file
does not know, begin double lane changes on the 9-DOF vehicle behind emulated boards, played by the
driver's own state machine, with and without a lead-in. Printed: how far the middle of the rear axle
is off the line on which the vehicle stood, and how far the vehicle is turned from it, at the first
steering of the maneuver proper; the median and the most of all vehicles.
"""

import argparse
import math

import numpy as np

from excitation_planner import Criterion
from excitation_planner.localisation import PlanarState
from excitation_planner.maneuver import family_by_name, lead_in_of, with_lead_in
from excitation_planner.planning import PlanRequest, plan_at
from excitation_planner.playback import Playback
from excitation_planner.schedule import Schedule
from excitation_planner.vehicle_watch import VehicleWatch
from excitation_planner.way_back.pursuit import Chassis
from tricycle_bridge.commands.command_stream import VehicleCommand
from tricycle_bringup.configuration import bridge_settings
from tricycle_core.readiness import Readiness
from tricycle_core.timing import TICK
from tricycle_sim.effects import effects_of, with_effects
from tricycle_sim.rig.emulated import EmulatedRig
from tricycle_sim.rig.host import Host
from tricycle_sim.rig.localisation import PoseNoise, measure_pose
from tricycle_sim.vehicle import draw_truth, load_vehicle

VEHICLE = load_vehicle()
UNKNOWN = "steering-zero", "steering-gain"
POSE_TICKS = 5  # between poses
LENGTHS = 0.0, 4.0, 8.0  # m


def planned(length):
    """Double lane change after a straight so much longer."""
    (led,) = with_lead_in([family_by_name("double_lane_change")], length)
    request = PlanRequest(VEHICLE, led, "cornering_stiffness", Criterion.C, samples=20)
    return plan_at(request, np.array([6.0, 6.0]))


def begun(plan, seed, *, led):
    """Deviation to the side [m] and of the heading [rad] when the maneuver proper begins."""
    rng = np.random.default_rng(seed)
    true = VEHICLE.replace(**draw_truth(VEHICLE, rng))
    effects = effects_of(VEHICLE, UNKNOWN)
    values = {}
    for effect in effects:
        drawn = effect.std * rng.standard_normal()
        values |= {name: change * drawn for name, change in effect.constants.items()}
    affected = with_effects(true, effects)
    true = affected.replace(**{n: affected.nominal[n] + v for n, v in values.items()})
    rig = EmulatedRig(true)
    rig.reset((0.0, 0.0, 0.0))
    host = Host(rig, bridge_settings(VEHICLE))
    host.arm()
    playback, chassis = Playback(VehicleWatch(odom_timeout=0.5), max_deviation=3.0), Chassis()
    commands = plan.commands
    rates = commands.speed / plan.tyre_radius
    playback.load(Schedule(commands.time, commands.steering_motor_angle, rates))
    playback.parts.add_path(plan.path)
    if led:
        playback.parts.add_lead_in(plan.lead_in)
    began, started = rig.time, None
    first = lead_in_of(commands, VEHICLE)
    while started is None or rig.time < started + first:
        now = rig.time
        playback.hear(Readiness(rig.armed, "" if rig.armed else "; ".join(host.log[-3:]), ""), now)
        if round(now / TICK) % POSE_TICKS == 0:
            p = measure_pose(rig.state, PoseNoise(), rng)
            speed, slip = math.hypot(p.vx, p.vy), math.atan2(p.vy, p.vx)
            playback.observe(PlanarState(p.x, p.y, p.yaw, speed, slip, p.yaw_rate), now, now)
        if playback.start_time is not None:
            started = playback.start_time
        elif now > began + 1.5 and not playback.state.driving:
            playback.start(now)
            line = chassis.axle(rig.state.x, rig.state.y, rig.state.yaw)
        command = playback.tick(now)
        if command is not None:
            wheel = command.wheel_rate * plan.tyre_radius
            host.target = VehicleCommand(command.steering_motor_angle, wheel)
        host.tick()
    x, y, yaw = chassis.axle(rig.state.x, rig.state.y, rig.state.yaw)
    aside = -(x - line[0]) * math.sin(line[2]) + (y - line[1]) * math.cos(line[2])
    return aside, math.remainder(yaw - line[2], math.tau)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--vehicles", type=int, default=50)
    arguments = parser.parse_args()
    print("straight                      aside / cm      turned / deg")
    for length in LENGTHS:
        plan = planned(length)
        for how in ("open loop", "lead-in"):
            ends = [begun(plan, n, led=how == "lead-in") for n in range(arguments.vehicles)]
            aside, turned = np.abs(ends).T * [[100.0], [math.degrees(1.0)]]
            print(
                f"{length:g} m longer, {how:12s}{np.median(aside):9.1f}{aside.max():7.1f}"
                f"{np.median(turned):11.2f}{turned.max():7.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
