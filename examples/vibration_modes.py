"""
Vibration modes of an arm over its poses
========================================

The springs of an arm's joints vibrate at frequencies that depend on the pose: a folded arm has less inertia.
``robot.modes(pose)`` has frequency, damping and joint of each.
"""

import matplotlib.pyplot as plt
import numpy as np

import flexhinf as fh

# %%
# The two-link arm of the catalogue hangs from its shoulder. The elbow folds; gravity hardly matters for the vibration.
robot = fh.load_robot("planar-two-link")
elbow = np.radians(np.linspace(-145.0, 145.0, 59))
vibrations = [[mode for mode in robot.modes((0.0, angle)) if mode.name == "vibration"] for angle in elbow]

# %%
figure, (above, below) = plt.subplots(2, 1, figsize=(7.0, 4.6), sharex=True, layout="constrained")
frequencies = {}
for k, name in enumerate(("slow vibration", "fast vibration")):
    frequencies[name] = np.array([modes[k].frequency for modes in vibrations])
    above.plot(np.degrees(elbow), frequencies[name], label=name)
    below.plot(np.degrees(elbow), [modes[k].damping for modes in vibrations], label=name)
above.set(ylabel="frequency (Hz)", ylim=(0.0, None))
below.set(ylabel="damping ratio", xlabel="elbow (°)", ylim=(0.0, None))
above.legend()
for axes in (above, below):
    axes.grid(alpha=0.3)
for name, values in frequencies.items():
    print(f"{name}: {values.min():.1f} to {values.max():.1f} Hz")
