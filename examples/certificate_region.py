"""
A proved region, and the one that sampling finds
================================================

On a level set of V the dissipation inequality holds for every disturbance. Sampling finds a level on which nothing
speaks against it; a certificate proves one with interval arithmetic, with the sine as it is, and a second program that
shares no code with the prover checks it again.
"""

import matplotlib.pyplot as plt
import numpy as np

import flexhinf as fh

# %%
# A pendulum about its upright position. The law is designed at 1.3 γ*, and checked at 1.6 γ*: a margin to prove.
plant = fh.Plant(
    lambda x, u, d, p: np.array([x[1], p.gravity * np.sin(x[0]) - 0.1 * x[1] + u[0] + d[0]]),
    lambda x, u, p: x[:1],
    states=("angle", "rate"), inputs=("torque",), disturbances=("push",), outputs=("angle",),
    parameters={"gravity": 9.81}, units={"angle": "rad", "rate": "rad/s", "torque": "N·m"},
)  # fmt: skip
problem = plant.with_objective(fh.Penalty({"angle": 10.0, "rate": 1.0}, effort=0.5))
star = fh.smallest_gamma(problem)
solution = fh.solve_hji(problem, 1.3 * star, degree=4)
sampled = solution.sampled_region(gamma=1.6 * star)
certificate = solution.certify(gamma=1.6 * star)
checked = certificate.check()

# %%
# Level sets of V in the phase plane, and the motion of the closed loop without a push.
angle, rate = np.meshgrid(np.linspace(-2.3, 2.3, 121), np.linspace(-9.0, 9.0, 121))
points = np.column_stack([angle.ravel(), rate.ravel()])
value = solution.value(points).reshape(angle.shape)
torque = solution.law(points)[:, 0].reshape(angle.shape)
figure, axes = plt.subplots(figsize=(7.0, 4.6), layout="constrained")
axes.streamplot(
    np.degrees(angle), rate, np.degrees(rate), 9.81 * np.sin(angle) - 0.1 * rate + torque,
    color="0.75", density=1.0, linewidth=0.7, arrowsize=0.7,
)  # fmt: skip
levels = {"sampled": sampled.level, "proved": certificate.level}
for (name, level), colour, width in zip(levels.items(), ("C1", "C0"), (5.0, 1.5)):
    axes.contour(np.degrees(angle), rate, value, [level], colors=colour, linewidths=width)
    axes.plot([], [], colour, linewidth=width, label=f"{name}: V ≤ {level:.4g}")
axes.set(xlabel="angle from upright (°)", ylabel="rate (rad/s)")
axes.legend(loc="upper right")
share = certificate.level / sampled.level
print(f"the proved level is {100 * share:.1f} % of the sampled one")
print(f"proved at γ = {certificate.gamma:.3f}; proved again by the checker: {checked.proved}")
