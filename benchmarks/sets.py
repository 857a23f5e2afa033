"""Search of a set of two maneuvers: what it finds, begun at the best combinations or anywhere.

    python benchmarks/sets.py [--seeds 4] [--budget 12000] [--criterion d]

A circle and a double lane change for one vehicle, planned as one set. Printed for each seed: the
criterion of the set that was found, evaluated on the same fresh vehicles for all, with the search
begun at the best combinations of single maneuvers (as `tricycle plan` does), and at corners and
Sobol' points of all operation parameters together.
"""

import argparse
from unittest import mock

import numpy as np

from excitation_planner import Box, Criterion, MeasurementNoise
from excitation_planner.design.information import (
    difference_points,
    information,
    information_costs,
    posterior_covariance,
)
from excitation_planner.maneuver import family_by_name
from excitation_planner.planning import PlanRequest, plan_set, planner
from excitation_planner.planning.prediction import ReplayedTrajectories
from tricycle_sim.vehicle import load_vehicle

VEHICLE = load_vehicle()
FAMILIES = tuple(map(family_by_name, ("circle", "double_lane_change")))
TARGET = "cornering_stiffness"
DRAWS = 64  # of the evaluation


def cost(plans, criterion):
    """Criterion of a set on fresh vehicles."""
    unknown, noise = Box.of(dict(VEHICLE.unknown)), MeasurementNoise()
    U = difference_points(len(unknown), DRAWS, seed=99)
    F = sum(
        information(
            U,
            ReplayedTrajectories(VEHICLE, family, noise.channels)(
                np.array(list(plan.operation.values())), unknown.from_unit(U)
            ),
            noise.of_trajectory,
        )
        for family, plan in zip(FAMILIES, plans, strict=True)
    )
    F = F[np.isfinite(F).all(axis=(1, 2))]
    costs = information_costs(posterior_covariance(F), criterion, unknown.index(TARGET))
    return float(costs.mean())


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--budget", type=int, default=12_000)
    parser.add_argument("--criterion", choices=[*"cda"], default="d")
    arguments = parser.parse_args()
    criterion = Criterion(arguments.criterion)
    print("seed   from combinations   from anywhere")
    for seed in range(arguments.seeds):
        request = PlanRequest(
            VEHICLE,
            FAMILIES[0],
            TARGET,
            criterion=criterion,
            others=FAMILIES[1:],
            budget=arguments.budget,
            seed=seed,
        )
        found = cost(plan_set(request), criterion)
        with mock.patch.object(planner, "best_combinations", return_value=(None, 0)):
            before = cost(plan_set(request), criterion)
        print(f"{seed:4d}{found:16.4g}{before:16.4g}", flush=True)


if __name__ == "__main__":
    main()
