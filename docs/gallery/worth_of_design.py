# %% [markdown]
# # What design is worth
#
# A designed circle and a random one, each driven by the same vehicles with hidden parameters: how
# far off is the cornering stiffness? `benchmarks/worth.py` does it with more vehicles, families and
# noises.

# %%
import matplotlib.pyplot as plt
import numpy as np

from excitation_planner import Criterion
from excitation_planner.maneuver import Circle
from excitation_planner.planning import PlanRequest, plan_at, plan_maneuver, random_feasible_point
from parameter_identification.drives.measured import Sensor, StartPose
from parameter_identification.drives.simulated import SensedMotion, SensorNoise, measure
from parameter_identification.identification import identify
from tricycle_sim.vehicle import draw_truth, load_vehicle
from tricycle_sim.vehicle.batch import simulate

VEHICLES = 8
TARGET = "cornering_stiffness"
vehicle = load_vehicle()
request = PlanRequest(vehicle, Circle(), TARGET, criterion=Criterion.C, budget=4000)
plans = {
    "designed": plan_maneuver(request),
    "random": plan_at(request, random_feasible_point(request, np.random.default_rng(0))),
}

# %%
low, high = vehicle.unknown[TARGET]
errors = {}
for name, plan in plans.items():
    errors[name] = []
    for seed in range(VEHICLES):
        rng = np.random.default_rng(seed)
        truth = draw_truth(vehicle, rng)
        motion = SensedMotion.of(simulate(vehicle.replace(**truth), plan.commands))
        noise = {Sensor.POSITION: SensorNoise(0.01)}  # m, at 20 Hz
        start = StartPose(0.0, 0.0, 0.0, position_std=0.02, heading_std=0.0175)  # as planned for
        drive = measure(motion, plan.commands, noise, rng=rng, standstill=1.0, start=start)
        estimate = identify([drive], vehicle, profiles=False).parameters[TARGET].estimate
        errors[name].append(100 * (estimate - truth[TARGET]) / (high - low))
    rms = np.sqrt(np.mean(np.square(errors[name])))
    expected = 100 * plan.predicted_std[TARGET] / (high - low)
    print(f"{name}: {plan.operation}, {rms:.1f} % of the range, expected {expected:.1f} %")

# %%
figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
for row, values in enumerate(errors.values()):
    axes.plot(values, [row] * VEHICLES, "o", alpha=0.6)
axes.axvline(0.0, color="black", linewidth=0.8)
axes.set_yticks(range(len(errors)), list(errors))
axes.set(xlabel=f"error of the {TARGET.replace('_', ' ')}, % of its range", ylim=(-0.6, 1.6))
figure.savefig("worth_of_design.png", dpi=80)
