"""A study by array jobs: adapt `create` and `simulate`; array_jobs.sh calls the rest.

python study.py ask FOLDER               asks, and prints how many simulations are pending
python study.py simulate FOLDER 3 8      simulates the third of eight parts of them
python study.py design FOLDER            prints the design
"""

import sys
from pathlib import Path

import numpy as np

from excitation_planner import InfeasibleManeuver, Study

TIME = np.linspace(0.0, 5.0, 51)


def create(folder):
    """What is to be designed."""
    operation = {"frequency": (0.5, 4.0), "amplitude": (0.1, 1.0)}
    unknown = {"stiffness": (80.0, 120.0), "damping": (0.5, 2.0)}
    return Study.create(
        folder, operation, unknown, "damping", criterion="c", draws=4, samples=20, budget=1200
    )


def simulate(x, P):
    """x (l,), P (n, k) to trajectories (n, time points, channels): a driven oscillator."""
    frequency, amplitude = x
    stiffness, damping = P.T[:, :, None]
    omega = 2 * np.pi * frequency
    phase = np.arctan2(damping * omega, stiffness - omega**2)
    gain = amplitude / np.hypot(stiffness - omega**2, damping * omega)
    return np.stack([gain * np.sin(omega * TIME - phase)], axis=-1)


def main():
    """One step of the study."""
    command, folder = sys.argv[1], Path(sys.argv[2])
    study = Study.open(folder) if (folder / "study.json").exists() else create(folder)
    if command == "ask":
        print(sum(len(proposal.samples) for proposal in study.ask()))
    elif command == "simulate":
        part, parts = int(sys.argv[3]), int(sys.argv[4])
        for proposal in study.pending(part - 1, parts):
            try:
                outputs = simulate(proposal.x, proposal.P)
                study.tell(proposal.point, proposal.samples, outputs)
            except InfeasibleManeuver as infeasible:
                study.tell_infeasible(proposal.point, str(infeasible))
    elif command == "design":
        print(study.design())
    else:
        sys.exit(__doc__)


if __name__ == "__main__":
    main()
