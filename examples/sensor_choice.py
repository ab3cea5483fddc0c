"""
Which encoder? The motor's, the link's, or both
===============================================

The encoder of the motor hardly sees what the link does behind its spring. A filter makes the best of what is measured,
and its covariance says how good that is before any run: here over the noise of the encoders.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.linalg import expm

import flexhinf as fh
from flexhinf.estimation import stationary_covariance

# %%
# Quanser's rotary flexible joint at 1 kHz. Random torques push link and motor; each encoder has the same noise.
robot, period = fh.load_robot("quanser-rotflex"), 1e-3
choices = {
    "motor": ("motor_position",), "link": ("link_position",), "motor and link": ("motor_position", "link_position"),
}  # fmt: skip
noises, process = np.geomspace(1e-5, 1e-2, 25), np.diag([0.0, 1e-2, 0.0, 1e-2]) ** 2

# %%
# The stationary covariance of a Kalman filter follows from the linearised plant alone.
figure, panels = plt.subplots(1, 2, figsize=(7.0, 3.6), layout="constrained")
spread = {}
for name, measured in choices.items():
    plant = robot.plant(measured)
    a, _, _, c = plant.linearise(*robot.operating_point())
    model = (expm(a * period), c)
    each = [stationary_covariance(model, process, noise**2 * np.eye(len(c))) for noise in noises]
    spread[name] = np.sqrt([np.diag(covariance) for covariance in each])
    for axes, state in zip(panels, ("link_position", "link_velocity"), strict=True):
        scale = 180.0 / np.pi
        axes.loglog(scale * noises, scale * spread[name][:, plant.index(state)], label=name)
for axes, what in zip(panels, ("link position (°)", "link velocity (°/s)"), strict=True):
    axes.set(xlabel="noise of each encoder (°)", ylabel=f"standard deviation of the {what}")
    axes.grid(alpha=0.3, which="both")
panels[0].legend()
middle = {name: 1e3 * values[12, 0] for name, values in spread.items()}
print(", ".join(f"{name}: {value:.2f} mrad" for name, value in middle.items()))
