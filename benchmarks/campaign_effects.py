"""What plans of a campaign gain and cost where they count effects beside the parameters.

    python benchmarks/campaign_effects.py [--seeds 2] [--budget 4000]

The first drive of a campaign for the cornering stiffness is planned as `tricycle campaign` does,
the best of circle and double lane change, with and without `--plan-effects all`. Printed for both:
what was chosen, the standard deviation of the target that is expected where all effects are
counted, in % of the range, and the processor time of the plan.
"""

import argparse
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from excitation_planner import Box, Criterion
from excitation_planner.design.noise import SIMULATED
from excitation_planner.maneuver import family_by_name
from excitation_planner.planning import PlanRequest, plan_maneuver
from excitation_planner.planning.prediction import (
    ReplayedTrajectories,
    nuisance_parameters,
    planned_effects,
    predicted_covariance,
)
from tricycle_sim.effects import EFFECTS
from tricycle_sim.vehicle import load_vehicle

VEHICLE = load_vehicle()
FAMILIES = {name: family_by_name(name) for name in ("circle", "double_lane_change")}
TARGET = "cornering_stiffness"


def planned(effects, seed, budget):
    """The plan of the first drive, and the processor time that it took [s]."""
    request = PlanRequest(
        VEHICLE,
        FAMILIES["circle"],
        TARGET,
        Criterion.C,
        budget=budget,
        seed=seed,
        noise=SIMULATED,
        effects=effects,
    )
    began = time.process_time()
    with ThreadPoolExecutor(1) as executor:  # in this process, whose time is counted
        plans = [
            plan_maneuver(replace(request, family=family), executor=executor)
            for family in FAMILIES.values()
        ]
    return min(plans, key=lambda plan: plan.criterion_cost), time.process_time() - began


def expected(plan):
    """Standard deviation of the target with all effects, in ranges."""
    effects = planned_effects(VEHICLE, EFFECTS)
    unknown = Box.of(dict(VEHICLE.unknown))
    simulate = ReplayedTrajectories(
        VEHICLE, FAMILIES[plan.maneuver], SIMULATED.channels, effects=effects
    )
    covariance = predicted_covariance(
        (simulate,),
        (np.array(list(plan.operation.values())),),
        unknown,
        SIMULATED.of_trajectory,
        seed=99,
        nuisances=nuisance_parameters(effects),
    )
    return float(np.sqrt(covariance[unknown.index(TARGET)][unknown.index(TARGET)]))


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--budget", type=int, default=4000)
    arguments = parser.parse_args()
    print("seed  plans count   expected std   takes   maneuver")
    for seed in range(arguments.seeds):
        for name, effects in (("parameters", ()), ("effects too", EFFECTS)):
            plan, took = planned(effects, seed, arguments.budget)
            values = ", ".join(f"{key} {value:.3g}" for key, value in plan.operation.items())
            print(
                f"{seed:4d}  {name:12s}{expected(plan):13.2%}{took:7.0f} s   "
                f"{plan.maneuver}: {values}",
                flush=True,
            )


if __name__ == "__main__":
    main()
