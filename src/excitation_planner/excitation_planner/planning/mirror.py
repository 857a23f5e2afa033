"""The mirror image of a plan: what it drives to the left, driven to the right."""

from dataclasses import replace

import numpy as np

from excitation_planner.area.room import Room
from excitation_planner.plan import Plan, Reference
from excitation_planner.planning.planner import on_area
from tricycle_core.errors import InfeasibleManeuver
from tricycle_sim.commands import Commands
from tricycle_sim.vehicle import Vehicle
from tricycle_sim.vehicle.batch import simulate


def mirrored(plan: Plan, vehicle: Vehicle) -> Plan:
    """Return a plan with all steering the other way round; what it was chosen by stays.

    The vehicle need not be symmetric: reference and tube are its own. On an area the start pose is
    searched anew.

    Parameters
    ----------
    plan : Plan
        To be mirrored.
    vehicle : Vehicle
        That the plan is for.

    Raises
    ------
    InfeasibleManeuver
        If the vehicle cannot drive it, or it does not fit the area, with the reason.
    """
    given = plan.commands
    commands = Commands(given.time, -given.steering_motor_angle, given.speed)
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
        commands=commands,
        path=plan.path * np.array([1.0, -1.0]),
        reference=Reference(motion.time, motion.x[0], motion.y[0], motion.yaw[0]),
        **place,
    )
