"""The whole plan of the vehicle: both maneuvers, both targets, six parameters; time and optimum.

    python benchmarks/plan.py [--criterion h] [--earlier STD] [--direct]

The last line compares the time with that of the same number of simulations alone, on all cores.
With --earlier 0.1 --criterion c they are planned as a step of a campaign: earlier drives have left
normally distributed parameters with this standard deviation, in ranges, about their middle.
With --direct each optimum stands beside that of DIRECT on the cost itself, over the same samples,
on as many maneuvers. Both are judged by the same fresh samples.
"""

import argparse
import time

import numpy as np

from excitation_planner import Criterion, Search
from excitation_planner.design.prior import BoxPrior
from excitation_planner.indices.sampling import sobol_sequence
from excitation_planner.maneuver import family_by_name
from excitation_planner.planning import PlanRequest, plan_at, plan_maneuver
from tricycle_sim.vehicle import load_vehicle
from tricycle_sim.vehicle.planar import simulate_planar


def cost_at(request, plan):
    """Cost of a plan's maneuver by samples of neither search."""
    x = np.array(list(plan.operation.values()))
    if request.criterion is Criterion.H:
        fresh = PlanRequest(request.vehicle, request.family, request.target, samples=400, seed=99)
        return plan_at(fresh, x).cost
    return plan_at(request, x).predicted_std[request.target] ** 2


def simulating(request, plan):
    """Time of as many simulations of a plan's maneuver as its search needed [s]."""
    low, high = np.array(list(request.vehicle.unknown.values())).T
    samples = low + (high - low) * sobol_sequence(1024, len(low), seed=0)
    begun = time.perf_counter()
    simulate_planar(request.vehicle, plan.commands, samples, lambda *_: None)
    return (time.perf_counter() - begun) * plan.simulations / len(samples)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--criterion", type=Criterion, default=Criterion.H)
    parser.add_argument("--earlier", type=float, metavar="STD", help="left by earlier drives")
    parser.add_argument("--direct", action="store_true", help="DIRECT beside it")
    arguments = parser.parse_args()
    vehicle, whole, alone = load_vehicle(), 0.0, 0.0
    k, prior = len(vehicle.unknown), None
    if arguments.earlier is not None:
        prior = BoxPrior(np.full(k, 0.5), arguments.earlier**2 * np.eye(k))
    searches = (Search.ADAPTIVE, Search.DIRECT) if arguments.direct else (Search.ADAPTIVE,)
    for name in ("circle", "double_lane_change"):
        for target in ("cornering_stiffness", "camber_stiffness"):
            costs = {}
            for search in searches:
                request = PlanRequest(
                    vehicle,
                    family_by_name(name),
                    target,
                    criterion=arguments.criterion,
                    search=search,
                    prior=prior,
                )
                begun = time.perf_counter()
                plan = plan_maneuver(request)
                seconds = time.perf_counter() - begun
                if search is Search.ADAPTIVE:
                    whole, alone = whole + seconds, alone + simulating(request, plan)
                costs[search] = cost_at(request, plan)
                x = ", ".join(f"{key} {value:.3f}" for key, value in plan.operation.items())
                print(
                    f"{name:20s} {target:20s} {search:9s} {arguments.criterion} = "
                    f"{costs[search]:.4g} at {x}; {plan.simulations} simulations, {seconds:.1f} s"
                    f"{'; ' + plan.verdict if plan.verdict else ''}",
                    flush=True,
                )
            if arguments.direct:
                ratio = costs[Search.ADAPTIVE] / costs[Search.DIRECT]
                print(f"{name:20s} {target:20s} adaptive / DIRECT {ratio:.4f}", flush=True)
    print(
        f"whole plan, criterion {arguments.criterion}: {whole:.0f} s, {whole / alone:.1f} times "
        f"its simulations alone ({alone:.0f} s)"
    )


if __name__ == "__main__":
    main()
