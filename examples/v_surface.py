"""
V surface of a pendulum that is held upright
============================================

V is the storage function of the closed loop: how much can still go wrong from a state. Gravity pulls less, the further
the pendulum leans, than its slope at the top says; so V falls below its quadratic part there.
"""

import matplotlib.pyplot as plt
import numpy as np

import flexhinf as fh

# %%
# A pendulum of 1 m about its upright position; a push disturbs it. The sine is expanded exactly, to any degree.
plant = fh.Plant(
    lambda x, u, d, p: np.array([x[1], p.gravity * np.sin(x[0]) - 0.1 * x[1] + u[0] + d[0]]),
    lambda x, u, p: x[:1],
    states=("angle", "rate"), inputs=("torque",), disturbances=("push",), outputs=("angle",),
    parameters={"gravity": 9.81}, units={"angle": "rad", "rate": "rad/s", "torque": "N·m"},
)  # fmt: skip
problem = plant.with_objective(fh.Penalty({"angle": 10.0, "rate": 1.0}, effort=0.5))
gamma = 2.0 * fh.smallest_gamma(problem)
quadratic, sextic = (fh.solve_hji(problem, gamma, degree) for degree in (2, 6))

# %%
# The surface is V of degree 6. Colours show by how much it differs from the quadratic V.
angle, rate = np.meshgrid(np.linspace(-1.2, 1.2, 61), np.linspace(-4.0, 4.0, 61))
points = np.column_stack([angle.ravel(), rate.ravel()])
surface, difference = sextic.value(points), sextic.value(points) - quadratic.value(points)
largest = np.abs(difference).max()
colours = plt.colormaps["coolwarm"](0.5 + 0.5 * difference.reshape(angle.shape) / largest)
figure = plt.figure(figsize=(7.0, 4.6), layout="constrained")
axes = figure.add_subplot(projection="3d")
axes.plot_surface(np.degrees(angle), rate, surface.reshape(angle.shape), facecolors=colours, shade=False)
axes.set(xlabel="angle (°)", ylabel="rate (rad/s)", zlabel="V")
axes.view_init(28, -60)
scale = plt.cm.ScalarMappable(plt.Normalize(-largest, largest), "coolwarm")
figure.colorbar(scale, ax=axes, shrink=0.7, pad=0.12, label="V minus its quadratic part")
share = float(sextic.value(np.array([1.0, 0.0])) / quadratic.value(np.array([1.0, 0.0])))
print(f"at 1 rad from upright V is {share:.2f} times its quadratic part")
