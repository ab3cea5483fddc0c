"""
How far a series is right: the residual of the equation
=======================================================

V of degree k satisfies the Hamilton–Jacobi–Isaacs equation up to terms of degree k + 1. Its residual therefore falls
with that power of the distance: a check that every solution can be put to, ``solution.residual(x)``.
"""

import matplotlib.pyplot as plt
import numpy as np

import flexhinf as fh

# %%
# Duffing's oscillator with a spring that softens, :math:`\\ddot x = -x + x^3 - 0.2\\dot x + u + d`.
plant = fh.PolynomialPlant(
    {(0, 1): (1.0, -0.2), (1, 0): (0.0, -1.0), (3, 0): (0.0, 1.0)},
    g1=[[0.0], [1.0]], g2=[[0.0], [1.0]], h={(1, 0): (1.0, 0.0), (0, 1): (0.0, 1.0)}, r2=1.0,
)  # fmt: skip
gamma = 1.5 * fh.smallest_gamma(plant)
directions = np.column_stack([np.cos(angles := np.linspace(0.0, 2.0 * np.pi, 90)), np.sin(angles)])
radii, slopes = np.geomspace(0.03, 1.0, 30), {}

# %%
# Largest residual on circles. In logarithmic axes the slope is the order, two more than the degree: f is odd.
figure, axes = plt.subplots(figsize=(7.0, 4.2), layout="constrained")
for degree in (2, 4, 6, 8):
    solution = fh.solve_hji(plant, gamma, degree)
    residual = np.array([np.abs(solution.residual(radius * directions)).max() for radius in radii])
    seen = (residual > 1e-12) & (radii < 0.3)
    slopes[degree] = float(np.polyfit(np.log(radii[seen]), np.log(residual[seen]), 1)[0])
    axes.loglog(radii, residual, label=f"V of degree {degree}: slope {slopes[degree]:.1f}")
axes.set(xlabel="distance from the operating point", ylabel="largest residual", ylim=(1e-16, 10.0))
axes.legend()
axes.grid(alpha=0.3, which="both")
