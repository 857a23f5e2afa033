# %% [markdown]
# # Your own simulator
#
# Any function of operation parameters `x` and unknown parameters `P` can be designed for: here the
# amplitude of a driven oscillator, measured to 1 mm, for its damping.

# %%
import matplotlib.pyplot as plt
import numpy as np

from excitation_planner import design_excitation, sensitivity

operation = {"frequency": (0.5, 4.0), "amplitude": (0.1, 1.0)}  # Hz, N/kg
unknown = {"stiffness": (80.0, 120.0), "damping": (0.5, 2.0)}  # 1/s², 1/s


def oscillator(x, P):
    """x (l,), P (n, k) to outputs (n,) in m."""
    frequency, amplitude = x
    stiffness, damping = P.T
    omega = 2 * np.pi * frequency
    return amplitude / np.hypot(stiffness - omega**2, damping * omega)


design = design_excitation(
    oscillator, operation, unknown, "damping", noise_variance=0.001**2, samples=40, budget=2000
)
print(design)

# %% [markdown]
# Near the resonance the damping matters, far from it only the stiffness. Without `noise_variance`
# every amplitude would be as good as any other.

# %%
figure, (search, best, off) = plt.subplots(1, 3, figsize=(14, 3.6), layout="constrained")
design.plot(search)
for axes, x in ((best, design.x), (off, np.array([3.0, 0.5]))):
    sensitivity(lambda P, x=x: oscillator(x, P), unknown).plot(axes)
    axes.set_title(f"{x[0]:.2f} Hz")
figure.savefig("own_simulator.png", dpi=80)
