"""
Van der Pol: what a nonlinear law costs, and what V predicts
============================================================

The oscillator :math:`\\ddot x = (1 - x^2)\\dot x - x + u` is unstable at rest. V of degree 8 predicts what a start
costs, and a run with its law costs just that. The linear law pays more, the further away it starts.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import solve_ivp

import flexhinf as fh

# %%
# Without a disturbance (γ = ∞) V is the cost to go, :math:`\frac12\int x^2 + \dot x^2 + u^2`.
plant = fh.PolynomialPlant(
    {(0, 1): (1.0, 1.0), (1, 0): (0.0, -1.0), (2, 1): (0.0, -1.0)},
    g1=[[0.0], [1.0]], g2=[[0.0], [1.0]], h={(1, 0): (1.0, 0.0), (0, 1): (0.0, 1.0)}, r2=1.0,
)  # fmt: skip
linear, nonlinear = (fh.solve_hji(plant, np.inf, degree) for degree in (2, 8))


def cost(law, start):
    """Cost of a run with a law, from a start."""

    def rates(t, z):
        x, (u,) = z[:2], law.law(z[:2])
        return [x[1], (1.0 - x[0] ** 2) * x[1] - x[0] + u, 0.5 * (x @ x + u**2)]

    return solve_ivp(rates, (0.0, 20.0), [*start, 0.0], rtol=1e-6, atol=1e-8).y[2, -1]


# %%
# Starts on a ray, and level sets of V: solid of degree 8, dashed of degree 2.
radii, ray = np.linspace(0.2, 1.6, 8), np.array([1.0, 1.0]) / np.sqrt(2.0)
paid = {name: [cost(law, r * ray) for r in radii] for name, law in (("linear", linear), ("V₈", nonlinear))}
predicted = nonlinear.value(radii[:, None] * ray)
grid = np.stack(np.meshgrid(np.linspace(-2, 2, 81), np.linspace(-2, 2, 81)), axis=-1)
figure, (left, right) = plt.subplots(1, 2, figsize=(7.0, 3.6), layout="constrained")
levels = [0.25, 1.0, 2.0, 4.0]
for law, style in ((nonlinear, "solid"), (linear, "dashed")):
    values = law.value(grid.reshape(-1, 2)).reshape(81, 81)
    lines = left.contour(*grid.T[:, :, :], values.T, levels, linestyles=style, colors="C0")
left.plot(*(radii[:, None] * ray).T, "k.", markersize=3)
left.set(xlabel="x", ylabel="rate of x (1/s)", aspect="equal", title="solid: V, dashed: its quadratic part")
left.title.set_fontsize(9)
right.plot(radii, paid["linear"], "C1", label="linear law")
right.plot(radii, paid["V₈"], "C0", label="law of V of degree 8")
right.plot(radii, predicted, "k:", label="V of degree 8")
right.set(xlabel="distance of the start", ylabel="cost")
right.legend()
right.grid(alpha=0.3)

# %%
more = paid["linear"][-1] / paid["V₈"][-1] - 1.0
near = abs(predicted[4] / paid["V₈"][4] - 1.0)
print(f"at distance {radii[-1]:.1f} the linear law costs {100 * more:.0f} % more")
print(f"at distance {radii[4]:.1f} V of degree 8 predicts the cost to {100 * near:.2f} %")
