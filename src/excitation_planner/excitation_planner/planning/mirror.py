"""The mirror image of a plan: what it drives to the left, driven to the right."""

from dataclasses import replace

import numpy as np

from excitation_planner.area.room import Room
from excitation_planner.maneuver.lead_in import straight_on
from excitation_planner.plan import Plan, Reference
from excitation_planner.planning.planner import on_area
from tricycle_core.errors import InfeasibleManeuver, PlanError
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.batch import simulate

OTHERWISE = 0.5  # m between reference and simulated path, beyond which it is another vehicle


def mirrored(plan: Plan, vehicle: Vehicle) -> Plan:
    """Return a plan with all steering reversed; search and cost stay those of the original.

    The other way round is about the angle of the steering motor with which the vehicle drives
    straight on. Plans that follow a path begin with it; where a campaign steers back what it has
    found, it is not that of the vehicle file. The vehicle need not be symmetric: reference and tube
    are its own. On an area the start pose is searched anew.

    Parameters
    ----------
    plan : Plan
        Plan to be mirrored.
    vehicle : Vehicle
        Vehicle that the plan is for.

    Raises
    ------
    InfeasibleManeuver
        If the vehicle cannot drive it, or it does not fit the area, with the reason.
    PlanError
        If the plan's reference is not what the vehicle does.
    """
    given, straight = plan.commands, round(straight_on(vehicle), 6)
    zero = float(given.steering_motor_angle[0]) or straight
    turned = given.steering_motor_angle - zero

    def commands_about(angle: float, sense: float) -> Commands:
        return Commands(given.time, angle + sense * turned, given.speed)

    own = simulate(vehicle, commands_about(straight, 1.0), threads=1)
    x, y = (
        np.interp(own.time, plan.reference.time, v) for v in (plan.reference.x, plan.reference.y)
    )
    if (off := float(np.hypot(own.x[0] - x, own.y[0] - y).max())) > OTHERWISE:
        raise PlanError(
            f"mirrored: the vehicle file moves up to {off:.1f} m otherwise than the plan's "
            "reference: give the file of the vehicle that was identified"
        )
    commands = commands_about(straight, -1.0)
    motion = simulate(vehicle, commands, threads=1)
    if not motion.feasibility.feasible[0]:
        raise InfeasibleManeuver(f"mirrored: {'; '.join(motion.feasibility.reasons(0))}")
    place = {}
    if plan.area is not None and plan.footprint is not None:
        room = Room(plan.area, plan.footprint, plan.noise.position_std)
        try:
            place = on_area(room, vehicle, commands)
        except InfeasibleManeuver as error:
            raise InfeasibleManeuver(f"mirrored: {error}") from error
    return replace(
        plan,
        commands=commands_about(zero, -1.0),
        path=plan.path * np.array([1.0, -1.0]),
        reference=Reference(motion.time, motion.x[0], motion.y[0], motion.yaw[0]),
        **place,
    )
