"""Kriging of the vehicle's trajectory error: how well 200 simulations predict it, and its indices.

    python benchmarks/kriging.py [--points 30] [--samples 200]

Operating points at random, circles and double lane changes in turn, six unknown parameters. R² on
300 other simulations. The error of the indices is the difference that the estimator of Eqs. 9-10
makes between the simulator and its metamodel on the same points: most of its own error cancels.
"""

import argparse
import time

import numpy as np
from threadpoolctl import threadpool_limits

from excitation_planner import Box, monte_carlo_indices, sensitivity
from excitation_planner.maneuver import Circle, DoubleLaneChange
from excitation_planner.planning.replay import ReplayedTrajectoryError
from tricycle_core.errors import InfeasibleManeuver
from tricycle_sim.vehicle import load_vehicle


def measure(f, x, unknown, *, samples, seed):
    result = sensitivity(lambda P: f(x, P), unknown, samples=samples, seed=seed)
    P = unknown.from_unit(np.random.default_rng(seed).uniform(size=(300, len(unknown))))
    m = f(x, P)
    lost = float(np.mean((result.predict(P) - m) ** 2) / m.var())
    simulator, metamodel = (
        monte_carlo_indices(lambda U, g=g: g(unknown.from_unit(U)), len(unknown), samples=512)
        for g in (lambda P: f(x, P), result.predict)
    )
    error = max(
        np.abs(simulator.main - metamodel.main).max(),
        np.abs(simulator.total - metamodel.total).max(),
    )
    start = time.perf_counter()
    result.model.fit(
        result.model.X_train_, result.predict(unknown.from_unit(result.model.X_train_))
    )
    return lost, error, 1 - result.leave_one_out_q2, time.perf_counter() - start


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=30)
    parser.add_argument("--samples", type=int, default=200)
    arguments = parser.parse_args()
    vehicle = load_vehicle()
    unknown = Box.of(dict(vehicle.unknown))
    rng = np.random.default_rng(0)
    found = []
    with threadpool_limits(1):
        for seed in range(arguments.points):
            family = (Circle(), DoubleLaneChange())[seed % 2]
            f = ReplayedTrajectoryError(vehicle, family)
            while True:
                x = family.operation.from_unit(rng.uniform(size=len(family.operation)))
                try:
                    found.append(measure(f, x, unknown, samples=arguments.samples, seed=seed))
                    break
                except InfeasibleManeuver:
                    continue
    lost, error, one_minus_q2, seconds = np.array(found).T
    print(f"{len(found)} operating points, {arguments.samples} samples, 6 parameters")
    for name, values in (
        ("1 - R²", lost),
        ("leave-one-out 1 - Q²", one_minus_q2),
        ("index error", error),
        ("seconds to fit", seconds),
    ):
        print(f"  {name:22s} median {np.median(values):8.1e}   worst {values.max():8.1e}")


if __name__ == "__main__":
    main()
