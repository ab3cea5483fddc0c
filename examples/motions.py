"""
From one pose to another: a step, a quintic, a jerk-limited move
================================================================

How a command moves decides how much an elastic joint swings. A step excites every vibration; the other motions have a
speed and an acceleration that are finite. All signals can be called like functions, and have their derivatives.
"""

import matplotlib.pyplot as plt
import numpy as np

import flexhinf as fh

# %%
# A move by one radian. The jerk-limited one is as fast as its limits allow.
signals = {
    "step": fh.Step(1.0, at=0.2),
    "quintic": fh.Quintic(0.0, 1.0, 1.0, at=0.2),
    "jerk-limited": fh.JerkLimited(0.0, 1.0, velocity=1.5, acceleration=6.0, jerk=40.0, at=0.2),
    "spline": fh.Spline([0.0, 0.2, 0.5, 0.9, 1.2, 1.5], [0.0, 0.0, 0.3, 0.7, 1.0, 1.0]),
}

# %%
time = np.linspace(0.0, 1.5, 601)
figure, panels = plt.subplots(3, 1, figsize=(7.0, 5.0), sharex=True, layout="constrained")
for name, signal in signals.items():
    panels[0].plot(time, signal(time), label=name)
    if name != "step":
        _, velocity, acceleration, *_ = signal.derivatives(time, 2)
        panels[1].plot(time, velocity)
        panels[2].plot(time, acceleration)
    else:
        panels[1].plot([], [])
        panels[2].plot([], [])
for axes, label in zip(panels, ("position (rad)", "velocity (rad/s)", "acceleration (rad/s²)"), strict=True):
    axes.set(ylabel=label)
    axes.grid(alpha=0.3)
panels[0].legend(ncols=2)
panels[2].set(xlabel="time (s)")
peak = {name: float(np.abs(s.derivatives(time, 1)[1]).max()) for name, s in signals.items() if name != "step"}
print(", ".join(f"{name}: at most {speed:.2f} rad/s" for name, speed in peak.items()))
