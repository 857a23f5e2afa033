# %% [markdown]
# # The paper's Fig. 14 in twenty lines
#
# What the trajectory error of a random circle depends on, beside that of the circle which is
# designed for the cornering stiffness. `tricycle reproduce fig14` computes all panels.

# %%
from functools import partial

import matplotlib.pyplot as plt
import numpy as np

from excitation_planner import design_excitation, sensitivity
from excitation_planner.maneuver import Circle
from excitation_planner.planning.replay import ReplayedTrajectoryError
from tricycle_sim.vehicle import load_vehicle

vehicle, circle = load_vehicle(), Circle()
error = ReplayedTrajectoryError(vehicle, circle)  # Eq. 14: f(x, P)
design = design_excitation(
    error, circle.operation, vehicle.unknown, "cornering_stiffness", samples=50, budget=2000
)
random = circle.operation.from_unit(np.random.default_rng(0).random(2))

figure, axes = plt.subplots(1, 2, figsize=(11, 4), sharex=True, layout="constrained")
for ax, title, x in zip(axes, ("random", "designed"), (random, design.x), strict=True):
    sensitivity(partial(error, x), vehicle.unknown).plot(ax)
    ax.set_title(f"{title}: radius {x[0]:.2f} m, speed {x[1]:.2f} m/s")
figure.savefig("figure_14.png", dpi=80)
print(design)
