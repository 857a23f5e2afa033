# %% [markdown]
# # Plan a maneuver
#
# The double lane change from which the cornering stiffness can be known best, measured as the
# simulation measures: position, heading and gyro.

# %%
import matplotlib.pyplot as plt

from excitation_planner import Criterion, MeasurementNoise
from excitation_planner.maneuver import DoubleLaneChange
from excitation_planner.planning import PlanRequest, plan_maneuver
from tricycle_sim.vehicle import load_vehicle

noise = MeasurementNoise(heading_std=0.002, yaw_rate_std=0.005, pose_rate=100.0, gyro_rate=100.0)
request = PlanRequest(
    load_vehicle(),
    DoubleLaneChange(),
    "cornering_stiffness",
    criterion=Criterion.C,
    noise=noise,
    budget=4000,
)
plan = plan_maneuver(request)
print(", ".join(f"{name} = {value:.2f}" for name, value in plan.operation.items()))

# %% [markdown]
# What is to be expected after the drive, one standard deviation in the unit of the parameter.
# `excitation_planner.plan.save_plan` writes the plan; `tricycle drive` drives it.

# %%
for name, std in plan.predicted_std.items():
    print(f"{name:25s} {std:.3g}")

figure, (road, command) = plt.subplots(2, 1, figsize=(9, 5), layout="constrained")
road.plot(*plan.path.T, label="path")
road.plot(plan.reference.x, plan.reference.y, label="nominal vehicle")
road.set(xlabel="x / m", ylabel="y / m")
road.legend()
command.plot(plan.commands.time, plan.commands.steering_motor_angle)
command.set(xlabel="time / s", ylabel="angle of the steering motor / rad")
figure.savefig("plan.png", dpi=80)
