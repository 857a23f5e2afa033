# %% [markdown]
# # Identify parameters from two drives
#
# A circle and a double lane change of a simulated vehicle with hidden parameters, measured with
# noise. `read_measured_drive` gives the same objects from bags.

# %%
import numpy as np

from excitation_planner.maneuver import Circle, DoubleLaneChange
from excitation_planner.planning.replay import nominal_run
from parameter_identification.drives.measured import Sensor
from parameter_identification.drives.simulated import SensedMotion, SensorNoise, measure
from parameter_identification.identification import identify
from tricycle_sim.vehicle import draw_truth, load_vehicle
from tricycle_sim.vehicle.batch import simulate

vehicle = load_vehicle()
rng = np.random.default_rng(1)
truth = draw_truth(vehicle, rng)
sensors = {
    Sensor.POSITION: SensorNoise(0.01, rate=50.0),  # m, Hz
    Sensor.HEADING: SensorNoise(0.002, rate=50.0),  # rad
    Sensor.YAW_RATE: SensorNoise(0.005, rate=50.0),  # rad/s
}
drives = []
for family, x in ((Circle(duration=15.0), [2.5, 0.95]), (DoubleLaneChange(), [2.0, 2.0])):
    commands = nominal_run(vehicle, family, np.array(x)).commands
    motion = SensedMotion.of(simulate(vehicle.replace(**truth), commands))
    drives.append(
        measure(motion, commands, sensors, rng=rng, name=family.name, standstill=1.0, truth=truth)
    )

found = identify(drives, vehicle)
print(found)

# %%
axes = found.plot()
axes.figure.set_size_inches(9, 4)
axes.figure.savefig("identify.png", dpi=80, bbox_inches="tight")
